// The shaders beside a twin in C++, and depth of scenes whose truth is known.
#include <cmath>
#include <limits>
#include <random>

#include <gtest/gtest.h>
#include <Eigen/Geometry>
#include <Eigen/LU>

#include <iclk/depth/depth_sweep.h>
#include <iclk/depth/internal/stages.h>
#include <iclk/engine/error.h>

#include "device.h"
#include "twin.h"

namespace iclk::test {
namespace {

constexpr int kWidth = 120, kHeight = 80, kPlanes = 32;
const Camera kCamera{100, 100, 59.5, 39.5, kWidth, kHeight};

/// A texture without repetition, smooth enough to be interpolated.
double texture(double x, double y) {
  double sum = 0.5;
  std::mt19937 random(3);
  for (int k = 0; k < 24; ++k) {
    const double angle = random() * 1e-9, phase = random() * 1e-9, wave = 5.0 + 1.3 * k;
    sum += 0.05 * std::sin(2 * M_PI * (x * std::cos(angle) + y * std::sin(angle)) / wave + phase);
  }
  return sum;
}

/// Takes (u, v, 1) of the reference to a view of the plane w = a + b u + c v (inverse depth over the reference's pixels).
Eigen::Matrix3d homography(const Eigen::Vector3d& plane, const SE3& T_10) {
  Eigen::Matrix3d K;
  K << kCamera.fx, 0, kCamera.cx, 0, kCamera.fy, kCamera.cy, 0, 0, 1;
  return K * T_10.R * K.inverse() + K * T_10.t * Eigen::RowVector3d(plane.y(), plane.z(), plane.x());
}

Map seen_from(const SE3& T_10, const Eigen::Vector3d& plane) {
  Map map(kWidth, kHeight);
  const Eigen::Matrix3d back = homography(plane, T_10).inverse();
  for (int v = 0; v < kHeight; ++v)
    for (int u = 0; u < kWidth; ++u) {
      const Eigen::Vector3d p = back * Eigen::Vector3d(u, v, 1);
      map.at(u, v) = static_cast<float>(texture(p.x() / p.z(), p.y() / p.z()));
    }
  return map;
}

Map seen(const Eigen::Vector3d& plane, const Eigen::Vector3d& t) { return seen_from({Eigen::Matrix3d::Identity(), t}, plane); }

ImageView view(const Map& map) { return {map.data.data(), map.width, map.height, 0, PixelFormat::r32f}; }
SE3 moved(const Eigen::Vector3d& t) { return {Eigen::Matrix3d::Identity(), t}; }

/// Disparity of a whole pixel a plane: baseline 0.5 m, planes from 0 to 31 px.
const Eigen::Vector3d kLeft(-0.5, 0, 0);
const DepthRange kRange{50.0 / 31, std::numeric_limits<double>::infinity()};

struct Figures {
  double median = 0, share = 0;  // relative; pixels with an answer
};
Figures error_of(const DepthMap& map, const Eigen::Vector3d& plane, int border) {
  std::vector<double> errors;
  int count = 0;
  for (int v = border; v < kHeight - border; ++v)
    for (int u = border + kPlanes; u < kWidth - border; ++u, ++count) {
      const double truth = plane.x() + plane.y() * u + plane.z() * v, w = static_cast<double>(map.inverse_depth.at(u, v));
      if (w > 0) errors.push_back(std::abs(w - truth) / truth);
    }
  if (errors.empty()) return {1, 0};
  std::sort(errors.begin(), errors.end());
  return {errors[errors.size() / 2], static_cast<double>(errors.size()) / count};
}

TEST(DepthSweep, ShadersEqualTheirTwins) {
  ICLK_NEED_DEVICE();
  const Map a = seen({0.2, 0.001, 0.002}, Eigen::Vector3d::Zero()), b = seen({0.2, 0.001, 0.002}, kLeft);
  DepthOptions options;
  DepthSweep sweep(device(), {kWidth, kHeight, kPlanes, 1}, options);
  const DepthSource source{view(b), kCamera, moved(kLeft)};
  sweep.compute(view(a), kCamera, std::span(&source, 1), kRange);

  const auto census_a = census_of(a), census_b = census_of(b), census = internal::DepthStages::census(sweep);
  ASSERT_EQ(census.size(), census_a.size() * 2);
  EXPECT_TRUE(std::equal(census_a.begin(), census_a.end(), census.begin()));
  EXPECT_TRUE(std::equal(census_b.begin(), census_b.end(), census.begin() + static_cast<std::ptrdiff_t>(census_a.size())));
  const auto volume = internal::DepthStages::volume(sweep);
  EXPECT_EQ(volume, costs_of(census_a, census_b, kWidth, kHeight, kPlanes));
  const int ways[8][2] = {{1, 0}, {-1, 0}, {0, 1}, {0, -1}, {1, 1}, {-1, 1}, {1, -1}, {-1, -1}};
  for (int i = 0; i < 8; ++i)
    EXPECT_EQ(internal::DepthStages::path(sweep, i), path_of(volume, a, kPlanes, ways[i][0], ways[i][1], options))
        << "path " << i;
}

TEST(DepthSweep, PlanesOfKnownInverseDepth) {
  ICLK_NEED_DEVICE();
  DepthSweep sweep(device(), {kWidth, kHeight, kPlanes, 1});
  for (const Eigen::Vector3d& plane : {Eigen::Vector3d(0.24, 0, 0), {0.15, 0.001, 0}, {0.1, 0.0005, 0.003}}) {
    const Map a = seen(plane, Eigen::Vector3d::Zero()), b = seen(plane, kLeft);
    const DepthSource source{view(b), kCamera, moved(kLeft)};
    const Figures e = error_of(sweep.compute(view(a), kCamera, std::span(&source, 1), kRange), plane, 6);
    EXPECT_LT(e.median, 0.001) << plane.transpose();  // 0.02 px
    EXPECT_GT(e.share, 0.97) << plane.transpose();
  }
}

/// A view of the plane, and what the sweep says of the reference's pixels that lie well inside it.
Figures figures_of(const Eigen::Vector3d& plane, const SE3& T_10) {
  const Map a = seen(plane, Eigen::Vector3d::Zero()), b = seen_from(T_10, plane);
  const DepthSource source{view(b), kCamera, T_10};
  DepthSweep sweep(device(), {kWidth, kHeight, kPlanes, 1});
  const DepthMap map = sweep.compute(view(a), kCamera, std::span(&source, 1), kRange);
  EXPECT_EQ(map.status, Status::converged) << map.reason;
  const Eigen::Matrix3d H = homography(plane, T_10);
  std::vector<double> errors;
  int count = 0;
  for (int v = 6; v < kHeight - 6; ++v)
    for (int u = 6; u < kWidth - 6; ++u) {
      const Eigen::Vector2d p = (H * Eigen::Vector3d(u, v, 1)).hnormalized();
      if (p.x() < 6 || p.y() < 6 || p.x() > kWidth - 7 || p.y() > kHeight - 7) continue;
      const double truth = plane.dot(Eigen::Vector3d(1, u, v)), w = static_cast<double>(map.inverse_depth.at(u, v));
      ++count;
      if (w > 0) errors.push_back(std::abs(w - truth) / truth);
    }
  std::sort(errors.begin(), errors.end());
  return errors.empty() ? Figures{1, 0} : Figures{errors[errors.size() / 2], static_cast<double>(errors.size()) / count};
}

TEST(DepthSweep, ViewsMayBeTurned) {
  ICLK_NEED_DEVICE();
  const Eigen::Vector3d plane(0.15, 0.0005, 0.001);
  for (const double tilt : {0.0, 15.0})
    for (const double roll : {0.0, 30.0, 45.0, 90.0, 135.0, 180.0, 300.0}) {
      const Eigen::Matrix3d R = (Eigen::AngleAxisd(roll * M_PI / 180, Eigen::Vector3d::UnitZ()) *
                                 Eigen::AngleAxisd(tilt * M_PI / 180, Eigen::Vector3d::UnitY()))
                                    .toRotationMatrix();
      // The tilted view stands where it looks at the same.
      const Eigen::Vector3d place(tilt > 0 ? -1.6 : 0.5, 0, 0);
      const Figures e = figures_of(plane, {R, -R * place});
      EXPECT_LT(e.median, 0.002) << "roll " << roll << " tilt " << tilt;
      EXPECT_GT(e.share, 0.95) << "roll " << roll << " tilt " << tilt;
    }
}

TEST(DepthSweep, ViewsMayBeFartherAway) {
  ICLK_NEED_DEVICE();
  const Eigen::Vector3d plane(0.2, 0.0005, 0.001);
  for (const double back : {-1.5, 2.0, 4.0}) {
    const Figures e = figures_of(plane, moved({-0.5, 0, back}));
    EXPECT_LT(e.median, 0.004) << back;
    EXPECT_GT(e.share, 0.9) << back;
  }
}

/// Fewer views than planned, one of which shows something else and is outvoted.
TEST(DepthSweep, TheBetterHalfOfTheViewsDecides) {
  ICLK_NEED_DEVICE();
  const Eigen::Vector3d plane(0.15, 0.001, 0);
  const Map a = seen(plane, Eigen::Vector3d::Zero()), wrong = seen({0.3, 0, 0}, {0.3, 0.4, 0});
  std::vector<Map> maps;
  const std::vector<Eigen::Vector3d> places = {kLeft, -kLeft, {0, 0.5, 0}, {0, -0.5, 0}, {0.3, 0.4, 0}};
  for (const Eigen::Vector3d& t : places) maps.push_back(&t == &places.back() ? wrong : seen(plane, t));
  std::vector<DepthSource> sources;
  for (size_t i = 0; i < maps.size(); ++i) sources.push_back({view(maps[i]), kCamera, moved(places[i])});
  DepthSweep sweep(device(), {kWidth, kHeight, kPlanes, 8});
  const DepthMap map = sweep.compute(view(a), kCamera, sources, kRange);
  const Figures e = error_of(map, plane, 6);
  EXPECT_LT(e.median, 0.002);
  EXPECT_GT(e.share, 0.97);
  EXPECT_GT(map.valid, 0.97);  // what leaves one view lies in another
}

TEST(DepthSweep, GainAndBiasOfAViewDoNotMatter) {
  ICLK_NEED_DEVICE();
  const Eigen::Vector3d plane(0.1, 0.0005, 0.003);
  const Map a = seen(plane, Eigen::Vector3d::Zero());
  Map b = seen(plane, kLeft);
  for (float& value : b.data) value = 0.6f * value + 0.2f;
  DepthSweep sweep(device(), {kWidth, kHeight, kPlanes, 1});
  const DepthSource source{view(b), kCamera, moved(kLeft)};
  const Figures e = error_of(sweep.compute(view(a), kCamera, std::span(&source, 1), kRange), plane, 6);
  EXPECT_LT(e.median, 0.003);
  EXPECT_GT(e.share, 0.97);
}

/// A near square before a far wall: what it hides in the view must have no answer, and what lies beyond the view none either.
TEST(DepthSweep, HiddenPixelsHaveNoAnswerUnlessASecondViewSeesThem) {
  ICLK_NEED_DEVICE();
  const int near = 20, far = 4;  // px of disparity
  const auto front = [](double u, double v) { return u >= 50 && u < 80 && v >= 20 && v < 60; };
  const auto image = [&](int side) {  // 0: reference, 1: the view to the right, -1: to the left
    Map map(kWidth, kHeight);
    for (int v = 0; v < kHeight; ++v)
      for (int u = 0; u < kWidth; ++u) {
        const double x = u + side * near, back = u + side * far;
        map.at(u, v) = static_cast<float>(front(x, v) ? texture(x + 300, v) : texture(back, v));
      }
    return map;
  };
  const Map a = image(0), right = image(1), left = image(-1);
  DepthSweep sweep(device(), {kWidth, kHeight, kPlanes, 2});
  const DepthSource sources[] = {{view(right), kCamera, moved(kLeft)}, {view(left), kCamera, moved(-kLeft)}};
  const DepthMap one = sweep.compute(view(a), kCamera, std::span(sources, 1), kRange);
  const DepthMap two = sweep.compute(view(a), kCamera, sources, kRange);
  const auto right_share = [&](const DepthMap& map, int from, int to, int disparity) {
    int good = 0, wrong = 0;
    for (int v = 24; v < 56; ++v)
      for (int u = from; u < to; ++u) {
        const auto w = static_cast<double>(map.inverse_depth.at(u, v));
        const bool right_one = std::abs(50 * w - disparity) < 1;
        good += right_one, wrong += w > 0 && !right_one;
      }
    const double all = 32.0 * (to - from);
    return std::pair(good / all, wrong / all);
  };
  EXPECT_GT(right_share(one, 54, 76, near).first, 0.98);
  EXPECT_GT(right_share(one, 90, 110, far).first, 0.98);
  // Left of the square 16 px are hidden in the view to the right; a border of the patch's size may be taken for the square.
  EXPECT_LT(right_share(one, 36, 45, far).first, 0.3);
  EXPECT_LT(right_share(one, 36, 45, far).second, 0.3);
  EXPECT_GT(right_share(two, 36, 45, far).first, 0.8);
  EXPECT_GT(two.valid, one.valid);
  DepthMap filled = one;
  fill(filled);
  EXPECT_GT(right_share(filled, 36, 45, far).first, 0.8);
  EXPECT_EQ(std::count(filled.inverse_depth.data.begin(), filled.inverse_depth.data.end(), 0.0f), 0);
}

/// The wall's left border leaves the view to the right: its neighbours tell its depth, and its confidence says who told it.
TEST(DepthSweep, UnseenPixelsFollowTheirNeighboursIfWanted) {
  ICLK_NEED_DEVICE();
  const Eigen::Vector3d plane(20 / 50.0, 0, 0);  // 20 px
  const Map a = seen(plane, Eigen::Vector3d::Zero()), b = seen(plane, kLeft);
  const DepthSource source{view(b), kCamera, moved(kLeft)};
  DepthOptions options;
  for (const bool keep : {false, true}) {
    options.keep_unseen = keep;
    DepthSweep sweep(device(), {kWidth, kHeight, kPlanes, 1}, options);
    const DepthMap map = sweep.compute(view(a), kCamera, std::span(&source, 1), kRange);
    int right = 0, answers = 0, confident = 0;
    for (int v = 0; v < kHeight; ++v)
      for (int u = 0; u < 16; ++u) {
        const auto w = static_cast<double>(map.inverse_depth.at(u, v));
        answers += w > 0, right += std::abs(50 * w - 20)<1, confident += map.confidence.at(u, v)> 0;
      }
    if (keep) {
      EXPECT_GT(right, 0.8 * 16 * kHeight);
    } else {
      EXPECT_LT(answers, 0.1 * 16 * kHeight);
    }
    EXPECT_LT(confident, 0.1 * 16 * kHeight) << keep;
  }
}

/// Without texture only a prior knows.
TEST(DepthSweep, PriorsHold) {
  ICLK_NEED_DEVICE();
  Map flat(kWidth, kHeight);
  std::fill(flat.data.begin(), flat.data.end(), 0.5f);
  DepthOptions options;
  options.uniqueness = 0;
  DepthSweep sweep(device(), {kWidth, kHeight, kPlanes, 1}, options);
  Features priors;
  for (int v = 1; v < kHeight; v += 3)
    for (int u = 31; u < kWidth; u += 3) priors.uv.push_back({u, v}), priors.inverse_depth.push_back(12 / 50.0);
  priors.uv.push_back({-5, 1e9}), priors.inverse_depth.push_back(1);
  priors.uv.push_back({50, std::numeric_limits<double>::quiet_NaN()}), priors.inverse_depth.push_back(1);
  const DepthSource source{view(flat), kCamera, moved(kLeft)};
  const Figures e = error_of(sweep.compute(view(flat), kCamera, std::span(&source, 1), kRange, priors), {12 / 50.0, 0, 0}, 12);
  EXPECT_LT(e.median, 0.05);
}

/// A slanted wall with bands that have no texture, which only paths know, over more rows than strips have.
TEST(DepthSweep, StripsSayWhatTheWholeSays) {
  ICLK_NEED_DEVICE();
  constexpr int kTall = 400;
  const Camera camera{100, 100, 59.5, 199.5, kWidth, kTall};
  const auto image = [&](bool moved_view) {
    std::mt19937 random(moved_view ? 5 : 6);
    Map map(kWidth, kTall);
    for (int v = 0; v < kTall; ++v)
      for (int u = 0; u < kWidth; ++u) {
        const bool band = v % 80 >= 40;
        const double noise = 0.02 * (random() * 0x1p-32 - 0.5), disparity = 4 + 0.05 * v;
        map.at(u, v) = static_cast<float>(noise + (band ? 0.5 : texture(u + (moved_view ? disparity : 0), v)));
      }
    return map;
  };
  const Map a = image(false), b = image(true);
  const DepthSource source{view(b), camera, moved(kLeft)};
  const DepthPlan plan{kWidth, kTall, kPlanes, 1};
  DepthSweep whole(device(), plan);
  const DepthMap expected = whole.compute(view(a), camera, std::span(&source, 1), kRange);
  EXPECT_EQ(whole.strips(), 1);
  EXPECT_GT(expected.valid, 0.6);
  DepthPlan small = plan;
  small.most_bytes = DepthSweep::memory(*device(), plan).total() * 6 / 10;
  EXPECT_LE(DepthSweep::memory(*device(), small).total(), small.most_bytes);
  DepthSweep strips(device(), small);
  EXPECT_GE(strips.strips(), 4);
  const DepthMap map = strips.compute(view(a), camera, std::span(&source, 1), kRange);
  size_t differ = 0;
  for (size_t i = 0; i < map.inverse_depth.data.size(); ++i)
    differ += std::abs(map.inverse_depth.data[i] - expected.inverse_depth.data[i]) > 1e-3f * expected.inverse_depth.data[i];
  EXPECT_LT(static_cast<double>(differ), 0.001 * static_cast<double>(map.inverse_depth.data.size()));

  small.most_bytes = 1'000'000;
  try {
    DepthSweep none(device(), small);
    ADD_FAILURE();
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::unsupported);
    EXPECT_NE(std::string(error.what()).find("1000000"), std::string::npos) << error.what();
  }
}

TEST(DepthSweep, AStatusSaysWhatTheMapIsWorth) {
  ICLK_NEED_DEVICE();
  const Eigen::Vector3d plane(0.15, 0.0005, 0.001);
  const Map a = seen(plane, Eigen::Vector3d::Zero()), b = seen(plane, kLeft);
  DepthSweep sweep(device(), {kWidth, kHeight, kPlanes, 1});
  const auto map_of = [&](const SE3& T_10, double farther = 0) {
    Features sparse;
    for (int v = 10; farther > 0 && v < kHeight; v += 12)
      for (int u = 40; u < kWidth - 6; u += 12)
        sparse.uv.push_back({u, v}), sparse.inverse_depth.push_back(plane.dot(Eigen::Vector3d(1, u, v)) / farther);
    const DepthSource source{view(b), kCamera, T_10};
    return sweep.compute(view(a), kCamera, std::span(&source, 1), kRange, sparse);
  };
  const auto turned = [](double degrees, const Eigen::Vector3d& axis) {
    return SE3{Eigen::AngleAxisd(degrees * M_PI / 180, axis).toRotationMatrix(), kLeft};
  };
  const DepthMap right = map_of(moved(kLeft));
  EXPECT_EQ(right.status, Status::converged) << right.reason;
  EXPECT_NEAR(right.seen, 1 - 15.5 / kWidth, 0.02);  // 0 to 31 px leave the view
  EXPECT_TRUE(std::isnan(right.agreeing));
  const DepthMap told = map_of(moved(kLeft), 1);
  EXPECT_EQ(told.status, Status::converged) << told.reason;
  EXPECT_GT(told.agreeing, 0.9);
  const DepthMap contradicted = map_of(moved(kLeft), 2);
  EXPECT_EQ(contradicted.status, Status::diverged) << contradicted.reason;
  EXPECT_LT(contradicted.agreeing, 0.2);
  EXPECT_NE(contradicted.reason.find("sparse depths"), std::string::npos);
  EXPECT_EQ(map_of(turned(90, Eigen::Vector3d::UnitZ())).status, Status::degenerate);
  EXPECT_EQ(map_of(turned(180, Eigen::Vector3d::UnitY())).status, Status::low_overlap);
}

TEST(DepthSweep, HostileInputIsRefusedWithItsName) {
  ICLK_NEED_DEVICE();
  const Map a = seen({0.2, 0, 0}, Eigen::Vector3d::Zero());
  DepthSweep sweep(device(), {kWidth, kHeight, kPlanes, 1});
  const auto refused = [&](DepthSource source, const DepthRange& range, const std::string& word) {
    try {
      sweep.compute(view(a), kCamera, std::span(&source, 1), range);
      ADD_FAILURE() << word;
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), ErrorCode::invalid_argument);
      EXPECT_NE(std::string(error.what()).find(word), std::string::npos) << error.what();
    }
  };
  const DepthSource good{view(a), kCamera, moved(kLeft)};
  DepthSource bad = good;
  bad.image.width = 60;
  refused(bad, kRange, "60x80");
  bad = good, bad.camera.fx = std::nan("");
  refused(bad, kRange, "fx");
  bad = good, bad.T_10.t.x() = std::nan("");
  refused(bad, kRange, "pose of view 0");
  bad = good, bad.T_10.R *= 2;
  refused(bad, kRange, "not a rotation");
  bad = good, bad.T_10.t.setZero();
  refused(bad, kRange, "baseline");
  refused(good, {5, 1}, "range");
  EXPECT_THROW(sweep.compute(view(a), kCamera, {}, kRange), Error);
  Map noise = a;
  std::fill(noise.data.begin(), noise.data.end(), std::numeric_limits<float>::quiet_NaN());
  const DepthSource nan{view(noise), kCamera, moved(kLeft)};
  const DepthMap map = sweep.compute(view(noise), kCamera, std::span(&nan, 1), kRange);
  for (const float w : map.inverse_depth.data) ASSERT_TRUE(std::isfinite(w));
}

}  // namespace
}  // namespace iclk::test
