#include "apps/eval/appearance_draw.h"

#include <gtest/gtest.h>

#include <cmath>
#include <set>

#include <opencv2/imgproc.hpp>

#include "appearance_expected.h"
#include "files.h"

namespace iclk {
namespace {

using test::expect_error;

/// RGB values as an image of 2 rows.
cv::Mat image_of(std::span<const float> rgb) {
  cv::Mat out(2, static_cast<int>(rgb.size()) / 6, CV_32FC3);
  for (int i = 0; i < static_cast<int>(out.total()); ++i)
    for (int c = 0; c < 3; ++c) out.at<cv::Vec3f>(i / out.cols, i % out.cols)[2 - c] = rgb[static_cast<size_t>(3 * i + c)];
  return out;
}

double difference(const cv::Mat& a, const cv::Mat& b) { return cv::norm(a, b, cv::NORM_INF); }

cv::Mat grey_image(int width, int height, double value) { return cv::Mat(height, width, CV_32FC1, cv::Scalar(value)); }

/// Something of every frequency, in colour.
cv::Mat texture(int width = 160, int height = 120) {
  cv::Mat out(height, width, CV_32FC3);
  for (int v = 0; v < height; ++v)
    for (int u = 0; u < width; ++u)
      out.at<cv::Vec3f>(v, u) = {static_cast<float>(0.5 + 0.3 * std::sin(0.11 * u + 0.5) * std::cos(0.17 * v)),
                                 static_cast<float>(0.4 + 0.25 * std::sin(0.9 * u) + 0.1 * std::cos(0.05 * v * u / 40)),
                                 static_cast<float>(0.3 + 0.2 * std::cos(0.6 * v))};
  return out;
}

TEST(ColourJitter, EachStepIsTorchvisions) {
  const cv::Mat image = image_of(expected::kImage);
  constexpr double kRounding = 2e-6;
  EXPECT_LT(difference(adjust_brightness(image, 1.4), image_of(expected::kBrighter)), kRounding);
  EXPECT_LT(difference(adjust_brightness(image, 0.6), image_of(expected::kDarker)), kRounding);
  EXPECT_LT(difference(adjust_contrast(image, 1.5), image_of(expected::kContrast)), kRounding);
  EXPECT_LT(difference(adjust_contrast(image, 0.25), image_of(expected::kFlat)), kRounding);
  EXPECT_LT(difference(adjust_saturation(image, 1.7), image_of(expected::kSaturated)), kRounding);
  EXPECT_LT(difference(adjust_saturation(image, 0.2), image_of(expected::kPale)), kRounding);
  EXPECT_LT(difference(adjust_hue(image, 0.3), image_of(expected::kHueUp)), kRounding);
  EXPECT_LT(difference(adjust_hue(image, -0.45), image_of(expected::kHueDown)), kRounding);
  const Jitter all{{2, 0, 3, 1}, 0.75, 1.3, 1.6, 0.12};
  EXPECT_LT(difference(apply_change(all, image), image_of(expected::kAll)), kRounding);
  const Jitter other_order{{0, 1, 2, 3}, 0.75, 1.3, 1.6, 0.12};
  EXPECT_GT(difference(apply_change(other_order, image), image_of(expected::kAll)), 0.01) << "the order matters";
}

TEST(ColourJitter, HueComesRoundAndGreyHasNone) {
  const cv::Mat image = texture(), grey = grey_image(8, 8, 0.3);
  EXPECT_LT(difference(adjust_hue(image, 0), image), 1e-6);
  EXPECT_LT(difference(adjust_hue(adjust_hue(image, 0.5), 0.5), image), 1e-5);
  EXPECT_EQ(difference(adjust_hue(grey, 0.2), grey), 0);
  EXPECT_EQ(difference(adjust_saturation(grey, 0.2), grey), 0);
  EXPECT_LT(difference(adjust_contrast(grey, 0.2), grey), 1e-6) << "all of it is the mean";
}

TEST(Severe, ExposureClips) {
  const cv::Mat image = texture();
  const cv::Mat over = apply_change(Exposure{1, 0}, image), under = apply_change(Exposure{-1, 0.1}, image);
  for (int i = 0; i < static_cast<int>(image.total()) * 3; ++i) {
    const float x = image.ptr<float>()[i];
    ASSERT_FLOAT_EQ(over.ptr<float>()[i], std::min(2 * x, 1.0f));
    ASSERT_NEAR(under.ptr<float>()[i], std::max(0.5f * x - 0.1f, 0.0f), 1e-6);
  }
  EXPECT_EQ(cv::countNonZero(over.reshape(1) >= 1) > 0, true) << "the test needs clipped pixels";
  EXPECT_EQ(cv::countNonZero(under.reshape(1) <= 0) > 0, true);
}

TEST(Severe, GammaKeepsBlackAndWhite) {
  cv::Mat image = (cv::Mat_<float>(1, 3) << 0, 0.25, 1);
  const cv::Mat out = apply_change(Gamma{0.5}, image);
  EXPECT_FLOAT_EQ(out.at<float>(0), 0);
  EXPECT_FLOAT_EQ(out.at<float>(1), 0.5);
  EXPECT_FLOAT_EQ(out.at<float>(2), 1);
}

TEST(Severe, VignettingKeepsTheCentreAndDarkensTheCorners) {
  const cv::Mat out = apply_change(Vignetting{0.8}, grey_image(81, 61, 0.5));
  EXPECT_FLOAT_EQ(out.at<float>(30, 40), 0.5);
  for (const cv::Point corner : {cv::Point(0, 0), cv::Point(80, 0), cv::Point(0, 60), cv::Point(80, 60)})
    EXPECT_NEAR(out.at<float>(corner), 0.1, 1e-6);
  EXPECT_LT(out.at<float>(30, 60), out.at<float>(30, 50));
}

TEST(Severe, FlareOnlyAddsLightMostOfItAtTheLamp) {
  const cv::Mat image = texture();
  const cv::Mat out = apply_change(Flare{0.25, 0.5, 0.6, 0.1}, image);
  EXPECT_GE(cv::norm(out, cv::NORM_L1), cv::norm(image, cv::NORM_L1));
  cv::Mat lost;
  cv::max(image - out, 0, lost);
  EXPECT_LT(cv::norm(lost, cv::NORM_INF), 1e-6);
  const int u = 40, v = 60;  // 0.25 of 159, 0.5 of 119
  const float x = image.at<cv::Vec3f>(v, u)[0];
  EXPECT_NEAR(out.at<cv::Vec3f>(v, u)[0], 1 - (1 - x) * (1 - 0.6), 2e-3);
}

TEST(Severe, MotionBlurKeepsTheMeanAndDoesNotShift) {
  const cv::Mat image = texture();
  const cv::Mat out = apply_change(MotionBlur{0.06, 0.7}, image);
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(cv::mean(out)[c], cv::mean(image)[c], 0.01);
  cv::Mat flat = grey_image(60, 40, 0.37);
  EXPECT_LT(difference(apply_change(MotionBlur{0.1, 1.2}, flat), flat), 1e-5);
  // A point becomes a segment about itself: its length, its direction and its centre.
  cv::Mat point = grey_image(101, 101, 0);
  point.at<float>(50, 50) = 1;
  const cv::Mat segment = apply_change(MotionBlur{0.2, M_PI / 6}, point);
  const cv::Moments m = cv::moments(segment);
  EXPECT_NEAR(m.m00, 1, 1e-4);
  EXPECT_NEAR(m.m10 / m.m00, 50, 1e-3);
  EXPECT_NEAR(m.m01 / m.m00, 50, 1e-3);
  const double length = 0.2 * 101, along = length * length / 12;  // variance of a uniform segment
  EXPECT_NEAR((m.mu20 + m.mu02) / m.m00, along, 0.05 * along + 0.5);
  EXPECT_NEAR(0.5 * std::atan2(2 * m.mu11, m.mu20 - m.mu02), M_PI / 6, 0.02) << "from x towards y";
}

TEST(Severe, NoiseHasItsSigmaAndItsSeed) {
  const cv::Mat image = grey_image(300, 300, 0.5);
  const auto deviation = [&](const Noise& noise) {
    cv::Scalar mean, sigma;
    cv::meanStdDev(apply_change(noise, image), mean, sigma);
    EXPECT_NEAR(mean[0], 0.5, 5 * 0.05 / 300);
    return sigma[0];
  };
  EXPECT_NEAR(deviation({0.05, 0, 1}), 0.05, 0.05 * 0.01);
  EXPECT_NEAR(deviation({0.03, 0.0032, 1}), 0.05, 0.05 * 0.01) << "0.03^2 + 0.0032 * 0.5 = 0.05^2";
  EXPECT_EQ(difference(apply_change(Noise{0.05, 0, 7}, image), apply_change(Noise{0.05, 0, 7}, image)), 0);
  EXPECT_GT(difference(apply_change(Noise{0.05, 0, 7}, image), apply_change(Noise{0.05, 0, 8}, image)), 0);
  cv::Mat colour(1, 2, CV_32FC3, cv::Scalar::all(0.5));
  const cv::Mat noisy = apply_change(Noise{0.1, 0, 99}, colour);
  for (int i = 0; i < 6; ++i)
    EXPECT_NEAR(noisy.at<cv::Vec3f>(0, i / 3)[2 - i % 3], 0.5 + 0.1 * expected::kNormals[i], 1e-6) << "red first";
}

TEST(Severe, JpegGoesThereAndBack) {
  const cv::Mat image = texture();
  const double fine = cv::norm(apply_change(Jpeg{95}, image), image, cv::NORM_L1) / static_cast<double>(image.total() * 3),
               coarse = cv::norm(apply_change(Jpeg{8}, image), image, cv::NORM_L1) / static_cast<double>(image.total() * 3);
  EXPECT_LT(fine, 0.05);
  EXPECT_GT(coarse, 1.3 * fine);
  EXPECT_LT(coarse, 0.2);
  const cv::Mat grey = grey_image(64, 48, 0.4);
  EXPECT_LT(difference(apply_change(Jpeg{90}, grey), grey), 0.01);
}

TEST(Severe, ShadowDarkensItsRectangleAndNothingElse) {
  const cv::Mat image = grey_image(201, 151, 0.8);  // diagonal 250
  const cv::Mat out =
      apply_change(Shadow{0.5, 0.5, M_PI / 2, 0.2, 0.1, 0.004, 0.75}, image);  // 50 px high, 25 px wide, each way
  EXPECT_NEAR(out.at<float>(75, 100), 0.2, 1e-6);
  EXPECT_NEAR(out.at<float>(75 + 45, 100 + 20), 0.2, 1e-6);
  EXPECT_FLOAT_EQ(out.at<float>(75, 100 + 30), 0.8);
  EXPECT_FLOAT_EQ(out.at<float>(75 + 55, 100), 0.8);
  EXPECT_NEAR(out.at<float>(75, 100 + 25), 0.5, 0.01) << "half way on the edge";
}

TEST(Adverse, HazeVeilsFlickerWavesBandsAreStraightTonesAreEven) {
  const cv::Mat image = grey_image(101, 81, 0.25);
  const cv::Mat hazy = apply_change(Haze{1.5, 0.85, 0, 0, 0.25}, image);  // as thick as it gets, everywhere
  EXPECT_NEAR(hazy.at<float>(40, 50), 0.25 * std::exp(-1.5) + 0.85 * (1 - std::exp(-1.5)), 1e-6);
  const cv::Mat flickers = apply_change(Flicker{0.4, 1, 0}, image);
  EXPECT_NEAR(flickers.at<float>(20, 3), 0.35, 1e-6) << "a quarter of the period down";
  EXPECT_NEAR(flickers.at<float>(60, 90), 0.15, 1e-6);
  const cv::Mat bands = apply_change(Banding{0.05, 7}, image) - image;
  EXPECT_NEAR(bands.at<float>(10, 5) - bands.at<float>(10, 6), bands.at<float>(70, 5) - bands.at<float>(70, 6), 1e-6);
  cv::Scalar mean, sigma;
  cv::meanStdDev(bands, mean, sigma);
  EXPECT_NEAR(sigma[0], 0.05 * std::sqrt(2.0), 0.015);
  cv::Mat halves = grey_image(200, 50, 0.1);
  halves.colRange(100, 200).setTo(0.8);
  const cv::Mat even = apply_change(ToneMap{0.5, 0.05}, halves);
  EXPECT_LT(even.at<float>(25, 195) / even.at<float>(25, 5), 4) << "they were 8 times apart";
  EXPECT_GT(even.at<float>(25, 195), even.at<float>(25, 5));
}

TEST(ChangedImage, KeepsTypesAndRounds) {
  const cv::Mat image(2, 2, CV_8UC3, cv::Scalar(10, 100, 202));
  const std::vector<Change> half = {Exposure{-1, 0}};
  const cv::Mat out = changed_image(image, half);
  ASSERT_EQ(out.type(), CV_8UC3);
  EXPECT_EQ(out.at<cv::Vec3b>(1, 1), cv::Vec3b(5, 50, 101));
  const cv::Mat deep(2, 2, CV_16UC1, cv::Scalar(40001));
  EXPECT_NEAR(changed_image(deep, half).at<ushort>(0, 0), 20000.5, 1);
  EXPECT_EQ(changed_image(image, {}).data, image.data) << "no change, no copy";
  expect_error([&] { changed_image(cv::Mat(2, 2, CV_32FC1), half); }, ErrorCode::unsupported, {"8-bit or 16-bit"});
}

TEST(AppearanceDraw, TheGeneratorIsTheDocumentedOne) {
  for (uint64_t n = 0; n < 3; ++n) EXPECT_EQ(counter_word(42, n), expected::kWords[n]);
  const uint64_t seed = appearance_seed(7, "000012", 3, Side::target);
  EXPECT_EQ(seed, expected::kSeed);
  const std::vector<Change> changes = draw_changes({"jitter", 0.4}, seed);
  ASSERT_EQ(changes.size(), 1u);
  const auto& jitter = std::get<Jitter>(changes[0]);
  for (size_t i = 0; i < 4; ++i) EXPECT_EQ(jitter.order[i], expected::kOrder[i]);
  EXPECT_DOUBLE_EQ(jitter.brightness, expected::kFactors[0]);
  EXPECT_DOUBLE_EQ(jitter.contrast, expected::kFactors[1]);
  EXPECT_DOUBLE_EQ(jitter.saturation, expected::kFactors[2]);
  EXPECT_DOUBLE_EQ(jitter.hue, expected::kFactors[3]);
}

TEST(AppearanceDraw, SevereDrawsWhatPythonDraws) {
  std::vector<std::string> names;
  std::vector<double> numbers;
  for (int variant = 0; variant < 6; ++variant)
    for (const Change& change : draw_changes({"severe", 0.9}, appearance_seed(7, "000012", variant, Side::reference))) {
      const auto json = to_json(change);
      for (const auto& [key, value] : json.items())
        if (key == "change")
          names.push_back(value);
        else
          numbers.push_back(value);
    }
  EXPECT_EQ(names, std::vector<std::string>(std::begin(expected::kSevere), std::end(expected::kSevere)));
  ASSERT_EQ(numbers.size(), std::size(expected::kSevereNumbers));
  for (size_t i = 0; i < numbers.size(); ++i) EXPECT_DOUBLE_EQ(numbers[i], expected::kSevereNumbers[i]) << i;
  EXPECT_EQ(std::set<std::string>(names.begin(), names.end()).size(), 8u) << "the six variants have every kind";
}

TEST(AppearanceDraw, FactorsFillTheirRangeAndOrdersAreAllDrawn) {
  std::set<std::array<int, 4>> orders;
  double least = 9, most = 0, hue = 0;
  for (int variant = 0; variant < 500; ++variant) {
    const auto jitter = std::get<Jitter>(draw_changes({"jitter", 0.7}, appearance_seed(0, "a", variant, Side::target)).front());
    orders.insert(jitter.order);
    for (const double f : {jitter.brightness, jitter.contrast, jitter.saturation}) {
      least = std::min(least, f);
      most = std::max(most, f);
    }
    hue = std::max(hue, std::abs(jitter.hue));
  }
  EXPECT_EQ(orders.size(), 24u);
  EXPECT_GE(least, 0.3);
  EXPECT_LT(least, 0.31);
  EXPECT_LE(most, 1.7);
  EXPECT_GT(most, 1.69);
  EXPECT_LE(hue, 0.5);
  EXPECT_GT(hue, 0.49);
}

TEST(AppearanceDraw, EverySeedAndOnlyItGivesItsOwnChanges) {
  const auto text = [](const std::string& kind, uint64_t seed, const std::string& id, int variant, Side side) {
    std::string all;
    for (const Change& c : draw_changes({kind, 0.5}, appearance_seed(seed, id, variant, side))) all += to_json(c).dump();
    return all;
  };
  for (const std::string kind : {"jitter", "severe"}) {
    const std::string one = text(kind, 1, "a", 2, Side::target);
    EXPECT_EQ(one, text(kind, 1, "a", 2, Side::target));
    EXPECT_NE(one, text(kind, 2, "a", 2, Side::target));
    EXPECT_NE(one, text(kind, 1, "b", 2, Side::target));
    EXPECT_NE(one, text(kind, 1, "a", 3, Side::target));
    EXPECT_NE(one, text(kind, 1, "a", 2, Side::reference));
  }
}

TEST(AppearanceDraw, SevereTakesHalfOfTheEightInTheirOrder) {
  std::map<std::string, int> counts;
  const std::vector<std::string> order = {"shadow", "vignetting", "flare", "motion_blur", "exposure", "noise", "gamma", "jpeg"};
  for (int variant = 0; variant < 400; ++variant) {
    const auto changes = draw_changes({"severe", 1}, appearance_seed(5, "p", variant, Side::target));
    ASSERT_FALSE(changes.empty());
    size_t before = 0;
    for (const Change& c : changes) {
      const std::string name = to_json(c)["change"];
      const auto at = static_cast<size_t>(std::find(order.begin(), order.end(), name) - order.begin());
      ASSERT_LT(at, order.size());
      EXPECT_TRUE(&c == &changes.front() || at > before);
      before = at;
      ++counts[name];
    }
  }
  for (const std::string& name : order) EXPECT_NEAR(counts[name], 200, 50) << name;
}

TEST(Unseen, CloudsDarkenDropsBlurChannelsMixEdgesHaveHalos) {
  const cv::Mat image = texture();
  const cv::Mat cloudy = apply_change(Clouds{0.6, 3, 5}, image);
  double least = 1, most = 0;
  for (int v = 0; v < image.rows; ++v)
    for (int u = 0; u < image.cols; ++u)
      if (const float x = image.at<cv::Vec3f>(v, u)[1]; x > 0.2f) {
        const double light = cloudy.at<cv::Vec3f>(v, u)[1] / x;
        least = std::min(least, light);
        most = std::max(most, light);
      }
  EXPECT_NEAR(least, 0.4, 0.1);
  EXPECT_NEAR(most, 1, 0.05);
  const cv::Mat wet = apply_change(Droplets{0.8, 20, 5}, image);
  EXPECT_GT(cv::norm(wet, image, cv::NORM_L1), 0);
  EXPECT_EQ(cv::norm(apply_change(Droplets{0, 20, 5}, image), image, cv::NORM_INF), 0);
  const cv::Mat grey(20, 30, CV_32FC3, cv::Scalar::all(0.4));
  EXPECT_LT(cv::norm(apply_change(ChannelMix{1, 5}, grey), grey, cv::NORM_INF), 1e-6) << "grey stays grey";
  EXPECT_GT(cv::norm(apply_change(ChannelMix{1, 5}, image), image, cv::NORM_L1), 0);
  cv::Mat edge(20, 40, CV_32FC1, cv::Scalar(0.3));
  edge.colRange(20, 40) = 0.6f;
  const cv::Mat sharp = apply_change(Sharpen{2, 0.03}, edge);
  EXPECT_LT(sharp.at<float>(10, 19), 0.25f);
  EXPECT_GT(sharp.at<float>(10, 20), 0.65f);
  EXPECT_NEAR(sharp.at<float>(10, 2), 0.3f, 1e-4);
}

TEST(AppearanceDraw, FamiliesTakeTheirFourAndNoSweepHasUnseen) {
  const std::map<std::string, std::vector<std::string>> families = {
      {"adverse", {"haze", "flicker", "banding", "tone_map"}}, {"unseen", {"clouds", "droplets", "channel_mix", "sharpen"}}};
  for (const auto& [name, family] : families) {
    std::map<std::string, int> counts;
    for (int variant = 0; variant < 400; ++variant)
      for (const Change& c : draw_changes(parse_appearance(name), appearance_seed(5, "p", variant, Side::target)))
        ++counts[to_json(c)["change"]];
    EXPECT_EQ(counts.size(), family.size());
    for (const std::string& kind : family) EXPECT_NEAR(counts[kind], 210, 50) << kind;
  }
  const auto& kinds = appearance_kinds();
  EXPECT_EQ(std::count(kinds.begin(), kinds.end(), "unseen"), 0);
  EXPECT_EQ(std::count(kinds.begin(), kinds.end(), "adverse"), 1);
  EXPECT_EQ(to_text(parse_appearance("unseen:0.5")), "unseen:0.5");
  EXPECT_EQ(draw_changes(parse_appearance("haze:1"), 3).size(), 1u);
  expect_error([] { parse_appearance("clouds:1"); }, ErrorCode::invalid_argument, {"clouds"});
}

TEST(AppearanceDraw, MoreStrengthIsMoreChange) {
  const cv::Mat image = texture();
  for (const std::string& kind : appearance_kinds()) {
    if (kind == "severe" || kind == "adverse") continue;
    const uint64_t seed = appearance_seed(3, "q", 0, Side::target);
    double before = 0;
    for (const double s : {0.05, 0.4, 1.0}) {
      cv::Mat out = image;
      for (const Change& c : draw_changes({kind, s}, seed)) out = apply_change(c, out);
      const double change = cv::norm(out, image, cv::NORM_L1);
      EXPECT_GT(change, before) << kind << " " << s;
      before = change;
    }
  }
}

TEST(AppearanceDraw, SpecsAreReadAndRefused) {
  EXPECT_TRUE(parse_appearance("clean").clean());
  EXPECT_EQ(parse_appearance("severe").strength, 1);
  EXPECT_EQ(to_text(parse_appearance("jitter:0.4")), "jitter:0.4");
  EXPECT_EQ(parse_appearance("motion_blur:0.25").strength, 0.25);
  for (const char* bad : {"", "jitter", "jitter:", "jitter:x", "jitter:-1", "jitter:2.5", "noise:1.5", "noise:0", "noise:nan",
                          "clean:1", "rain:0.5"})
    expect_error([&] { parse_appearance(bad); }, ErrorCode::invalid_argument, {"appearance '"});
  expect_error([] { parse_appearance("rain:1"); }, ErrorCode::invalid_argument, {"rain", "vignetting", "severe"});
}

}  // namespace
}  // namespace iclk
