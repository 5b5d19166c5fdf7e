#include "apps/eval/appearance_draw.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include <iclk/engine/error.h>
#include <iclk/session/io/text.h>

#include "apps/json/format.h"

namespace iclk {
namespace {

constexpr double kPi = std::numbers::pi;

Jitter draw_jitter(double s, Random& random) {
  Jitter c;
  for (int i = 3; i > 0; --i) std::swap(c.order[static_cast<size_t>(i)], c.order[static_cast<size_t>(random.below(i + 1))]);
  const double least = std::max(0.0, 1 - s), hue = std::min(s, 0.5);
  c.brightness = random.uniform(least, 1 + s);
  c.contrast = random.uniform(least, 1 + s);
  c.saturation = random.uniform(least, 1 + s);
  c.hue = random.uniform(-hue, hue);
  return c;
}

Exposure draw_exposure(double s, Random& random) {
  const int sign = random.sign();
  return {sign * 2.5 * s, sign > 0 ? 0 : 0.04 * s};
}

Gamma draw_gamma(double s, Random& random) {
  const double exponent = 1 + 1.5 * s;
  return {random.sign() > 0 ? exponent : 1 / exponent};
}

Flare draw_flare(double s, Random& random) {
  Flare c;
  c.x = random.uniform(-0.1, 1.1);
  c.y = random.uniform(-0.1, 1.1);
  c.amount = 0.9 * s;
  c.radius = random.uniform(0.08, 0.2);
  return c;
}

Shadow draw_shadow(double s, Random& random) {
  Shadow c;
  c.x = random.uniform();
  c.y = random.uniform();
  c.angle = random.uniform(0, kPi);
  c.half_length = random.uniform(0.15, 0.6);
  c.half_width = random.uniform(0.05, 0.25);
  c.softness = random.uniform(0.002, 0.06);
  c.darkness = 0.85 * s;
  return c;
}

using Draw = Change (*)(double strength, Random& random);
struct Kind {
  const char* name;
  Draw draw;
};
/// In the order in which light meets them: the scene, the lens, the shutter, the sensor, the file.
constexpr Kind kSevere[] = {
    {"shadow", [](double s, Random& r) -> Change { return draw_shadow(s, r); }},
    {"vignetting", [](double s, Random&) -> Change { return Vignetting{0.95 * s}; }},
    {"flare", [](double s, Random& r) -> Change { return draw_flare(s, r); }},
    {"motion_blur",
     [](double s, Random& r) -> Change {
       return MotionBlur{0.04 * s, r.uniform(0, kPi)};
     }},
    {"exposure", [](double s, Random& r) -> Change { return draw_exposure(s, r); }},
    {"noise",
     [](double s, Random& r) -> Change {
       return Noise{0.06 * s, 0.004 * s, r.word()};
     }},
    {"gamma", [](double s, Random& r) -> Change { return draw_gamma(s, r); }},
    {"jpeg", [](double s, Random&) -> Change { return Jpeg{static_cast<int>(std::lround(95 - 87 * s))}; }},
};

constexpr Kind kAdverse[] = {
    {"haze",
     [](double s, Random& r) -> Change {
       Haze c;
       c.density = 2.5 * s;
       c.kx = r.uniform(-1.5, 1.5);
       c.ky = r.uniform(-1.5, 1.5);
       c.phase = r.uniform();
       return c;
     }},
    {"flicker",
     [](double s, Random& r) -> Change {
       Flicker c;
       c.amount = 0.5 * s;
       c.periods = r.uniform(0.5, 4);
       c.phase = r.uniform();
       return c;
     }},
    {"banding",
     [](double s, Random& r) -> Change {
       return Banding{0.04 * s, r.word()};
     }},
    {"tone_map",
     [](double s, Random& r) -> Change {
       return ToneMap{0.8 * s, r.uniform(0.04, 0.12)};
     }},
};

constexpr Kind kUnseen[] = {
    {"clouds",
     [](double s, Random& r) -> Change {
       const double cells = r.uniform(1.5, 6);
       return Clouds{1.2 * s, cells, r.word()};
     }},
    {"droplets",
     [](double s, Random& r) -> Change {
       return Droplets{1.3 * s, 20, r.word()};
     }},
    {"channel_mix",
     [](double s, Random& r) -> Change {
       return ChannelMix{1.3 * s, r.word()};
     }},
    {"sharpen",
     [](double s, Random& r) -> Change {
       return Sharpen{5 * s, r.uniform(0.001, 0.006)};
     }},
};

/// Each with probability 1/2, at least one.
std::vector<Change> draw_some(std::span<const Kind> kinds, double strength, Random& random) {
  std::vector<Change> all, taken;
  for (const Kind& kind : kinds) {
    const bool take = random.uniform() < 0.5;
    const double own_strength = strength * random.uniform(0.2, 0.7);
    Random own(random.word());
    all.push_back(kind.draw(own_strength, own));
    if (take) taken.push_back(all.back());
  }
  if (taken.empty()) taken.push_back(all[static_cast<size_t>(random.below(static_cast<int>(all.size())))]);
  return taken;
}

}  // namespace

const std::vector<std::string>& appearance_kinds() {
  static const std::vector<std::string> kinds = [] {
    std::vector<std::string> names = {"jitter"};
    for (const Kind& kind : kSevere) names.emplace_back(kind.name);
    names.emplace_back("severe");
    for (const Kind& kind : kAdverse) names.emplace_back(kind.name);
    names.emplace_back("adverse");
    return names;
  }();
  return kinds;
}

AppearanceSpec parse_appearance(const std::string& text) {
  const auto fail = [&](const std::string& why) {
    throw Error(ErrorCode::invalid_argument, "appearance '" + printable(text) + "': " + why);
  };
  AppearanceSpec spec;
  const size_t colon = text.find(':');
  spec.kind = text.substr(0, colon);
  if (spec.clean()) {
    if (colon != std::string::npos) fail("clean takes no strength");
    return spec;
  }
  const auto& kinds = appearance_kinds();
  const bool family = spec.kind == "severe" || spec.kind == "adverse" || spec.kind == "unseen";
  if (!family && std::find(kinds.begin(), kinds.end(), spec.kind) == kinds.end()) {
    std::string all = "clean";
    for (const std::string& kind : kinds) all += ", " + kind;
    all += ", unseen";
    fail("the kind must be one of " + all + ", then a colon and the strength, such as jitter:0.4");
  }
  if (colon == std::string::npos) {
    if (!family) fail("needs a strength, such as " + spec.kind + ":0.4");
    spec.strength = 1;
    return spec;
  }
  const auto strength = to_number(text.substr(colon + 1));
  const double most = spec.kind == "jitter" ? 2 : 1;
  if (!strength || !(*strength > 0) || *strength > most)
    fail("the strength must lie in (0, " + std::string(most > 1 ? "2" : "1") + "]");
  spec.strength = *strength;
  return spec;
}

std::string to_text(const AppearanceSpec& spec) {
  return spec.clean() ? spec.kind : formatted("%s:%g", spec.kind.c_str(), spec.strength);
}

uint64_t appearance_seed(uint64_t seed, std::string_view id, int variant, Side side) {
  uint64_t s = counter_word(seed, 0);
  for (const uint64_t word : {fnv1a(id), static_cast<uint64_t>(variant), static_cast<uint64_t>(side)})
    s = counter_word(s ^ word, 0);
  return s;
}

std::vector<Change> draw_changes(const AppearanceSpec& spec, uint64_t seed) {
  Random random(seed);
  if (spec.clean()) return {};
  if (spec.kind == "jitter") return {draw_jitter(spec.strength, random)};
  for (const std::span<const Kind> kinds : {std::span<const Kind>(kSevere), std::span<const Kind>(kAdverse)})
    for (const Kind& kind : kinds)
      if (spec.kind == kind.name) return {kind.draw(spec.strength, random)};
  if (spec.kind == "adverse") return draw_some(kAdverse, spec.strength, random);
  if (spec.kind == "unseen") return draw_some(kUnseen, spec.strength, random);
  return draw_some(kSevere, spec.strength, random);
}

}  // namespace iclk
