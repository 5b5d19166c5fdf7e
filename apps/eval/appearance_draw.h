#pragma once
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "apps/eval/appearance.h"

namespace iclk {

/// What is asked for: a kind of change and its strength.
///
///   clean         nothing
///   jitter:S      colour jitter: factors uniform in [max(0, 1 - S), 1 + S], hue in [-h, h] with h = min(S, 0.5)
///   exposure:S    +-2.5 S stops, the darker with black 0.04 S
///   gamma:S       exponent (1 + 1.5 S)^+-1
///   vignetting:S  fall-off 0.95 S
///   flare:S       amount 0.9 S, lamp at x, y uniform in [-0.1, 1.1], radius uniform in [0.08, 0.2]
///   motion_blur:S 0.04 S of the width, angle uniform in [0, pi]
///   noise:S       sigma 0.06 S, shot 0.004 S
///   jpeg:S        quality round(95 - 87 S)
///   shadow:S      darkness 0.85 S, place uniform in the image, angle in [0, pi], half length in [0.15, 0.6], half width in
///                 [0.05, 0.25], softness in [0.002, 0.06]
///   severe:S      each of the eight with probability 1/2, at least one, at a strength uniform in [0.2, 0.7] S
///   haze:S        density 2.5 S
///   flicker:S     amount 0.5 S
///   banding:S     sigma 0.04 S
///   tone_map:S    amount 0.8 S
///   adverse:S     these four, as severe takes its eight
///   unseen:S      clouds (darkness 1.2 S), droplets (amount 1.3 S), channel_mix (amount 1.3 S), sharpen (amount 5 S), taken in
///                 the same way: for sealed sets alone, and never to be trained or chosen on
///
/// S lies in (0, 1], that of jitter in (0, 2]. Where a kind has two signs, each has probability 1/2.
struct AppearanceSpec {
  std::string kind = "clean";
  double strength = 0;
  bool clean() const { return kind == "clean"; }
};

/// "jitter:0.4", "severe" (= severe:1), "clean", ... Throws Error(invalid_argument) that lists the kinds or the range.
AppearanceSpec parse_appearance(const std::string& text);
std::string to_text(const AppearanceSpec& spec);

/// All kinds but clean and unseen.
const std::vector<std::string>& appearance_kinds();

/// A stream of SplitMix64 (counter_word), the same in any language:
///   uniform()         (word >> 11) 2^-53, in [0, 1)
///   uniform(a, b)     a + (b - a) uniform()
///   below(n)          floor(n uniform())
class Random {
 public:
  explicit Random(uint64_t seed) : seed_(seed) {}
  uint64_t word() { return counter_word(seed_, n_++); }
  double uniform() { return static_cast<double>(word() >> 11) * 0x1p-53; }
  double uniform(double a, double b) { return a + (b - a) * uniform(); }
  int below(int n) { return static_cast<int>(n * uniform()); }
  int sign() { return below(2) == 1 ? 1 : -1; }

 private:
  uint64_t seed_, n_ = 0;
};

enum class Side : uint64_t { reference, target };

/// The seed of a pair's changes: s = counter_word(seed, 0), then s = counter_word(s ^ w, 0) for w = fnv1a(id) (io/text.h),
/// variant, side. A pair's changes do not depend on its place in the set.
uint64_t appearance_seed(uint64_t seed, std::string_view id, int variant, Side side);

/// Draws the changes, in the order in which they are applied: shadow, vignetting, flare, motion_blur, exposure, noise, gamma,
/// jpeg.
///
/// Numbers are taken from Random(seed) in this order. A change: what of its struct is drawn, in the order of its fields (a sign
/// is sign(), a noise's seed is word()). Jitter: for i = 3, 2, 1, with j = below(i + 1), order[i] and order[j] change places;
/// then brightness, contrast, saturation, hue. severe: for each of the eight, in the order above, uniform() < 0.5 takes it, its
/// strength is S uniform(0.2, 0.7), and it is drawn from Random(word()); these three are drawn for all eight. Where none was
/// taken, number below(8) is. adverse and unseen: the same with their four; haze draws kx, ky in [-1.5, 1.5] and phase, flicker
/// periods in [0.5, 4] and phase, tone mapping its radius in [0.04, 0.12]; clouds draw cells in [1.5, 6] and a seed, droplets
/// and channel_mix a seed, sharpen its radius in [0.001, 0.006].
std::vector<Change> draw_changes(const AppearanceSpec& spec, uint64_t seed);

}  // namespace iclk
