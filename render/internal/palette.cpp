#include <iclk/render/internal/palette.h>

namespace iclk::internal {
namespace {

const Palette kPlain{.meadow = {{{104, 128, 62}, {150, 140, 84}}},
                     .crops = {{{186, 164, 98}, {138, 104, 74}, {116, 142, 62}, {204, 186, 124}, {98, 78, 60}, {150, 160, 84}}},
                     .hedge = {50, 68, 38},
                     .crown = {{{52, 84, 44}, {104, 124, 58}}},
                     .leaves = {{{52, 84, 44}, {150, 120, 50}}},
                     .floor = {36, 42, 28},
                     .road = {{{112, 112, 116}, {140, 134, 126}}}};

const Palette kSpring{.meadow = {{{96, 140, 58}, {128, 150, 76}}},
                      .crops = {{{112, 84, 62}, {136, 108, 80}, {86, 138, 56}, {206, 196, 60}, {100, 78, 60}, {110, 150, 70}}},
                      .hedge = {84, 108, 52},
                      .crown = {{{46, 76, 44}, {78, 102, 54}}},
                      .leaves = {{{110, 142, 64}, {150, 168, 88}}},
                      .bare = 0.25,
                      .floor = {58, 56, 36},
                      .road = {{{108, 108, 112}, {136, 130, 122}}}};

const Palette kSummer{
    .meadow = {{{104, 128, 62}, {164, 150, 92}}},
    .crops = {{{198, 174, 106}, {176, 150, 96}, {84, 116, 52}, {214, 194, 130}, {96, 128, 56}, {150, 150, 84}}},
    .hedge = {50, 72, 38},
    .crown = {{{44, 72, 42}, {74, 98, 52}}},
    .leaves = {{{58, 90, 44}, {98, 122, 58}}},
    .floor = {36, 42, 28},
    .road = {{{118, 117, 118}, {146, 140, 130}}}};

const Palette kAutumn{.meadow = {{{112, 122, 66}, {142, 130, 80}}},
                      .crops = {{{112, 88, 66}, {98, 78, 60}, {122, 134, 70}, {170, 150, 104}, {104, 82, 62}, {132, 116, 84}}},
                      .hedge = {104, 84, 44},
                      .crown = {{{44, 70, 42}, {72, 94, 50}}},
                      .leaves = {{{146, 96, 40}, {190, 148, 58}}},
                      .bare = 0.2,
                      .floor = {92, 70, 42},
                      .road = {{{100, 100, 104}, {124, 120, 114}}}};

const Palette kWinter{.meadow = {{{116, 118, 78}, {138, 128, 92}}},
                      .crops = {{{104, 86, 70}, {94, 78, 64}, {108, 124, 74}, {128, 110, 86}, {98, 80, 66}, {116, 118, 84}}},
                      .hedge = {88, 78, 62},
                      .crown = {{{40, 62, 42}, {64, 84, 50}}},
                      .leaves = {{{108, 96, 80}, {132, 120, 102}}},
                      .bare = 0.75,
                      .floor = {96, 82, 62},
                      .road = {{{84, 84, 90}, {104, 102, 102}}}};

}  // namespace

const Palette& palette(const std::optional<Date>& date) {
  static const Palette snow = [] {
    Palette p = kWinter;
    p.snow = 1;
    return p;
  }();
  if (!date) return kPlain;
  switch (date->season) {
    case Season::spring: return kSpring;
    case Season::summer: return kSummer;
    case Season::autumn: return kAutumn;
    case Season::winter: return kWinter;
    case Season::snow: break;
  }
  return snow;
}

}  // namespace iclk::internal
