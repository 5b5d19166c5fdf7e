// Derivatives by finite differences, and the conventions of pose, camera and weights. No device.
#include <gtest/gtest.h>

#include <limits>
#include <random>

#include <unsupported/Eigen/MatrixFunctions>

#include <iclk/align/solver/jacobian.h>
#include <iclk/align/solver/normal_equations.h>
#include <iclk/align/solver/weights.h>
#include <iclk/engine/error.h>

namespace iclk {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN(), kInf = std::numeric_limits<double>::infinity();

template <class Call>
std::string refusal(Call&& call) {
  try {
    call();
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::invalid_argument);
    return error.what();
  }
  return "accepted";
}

Vector6d random_twist(std::mt19937& random, double rho, double angle) {
  std::normal_distribution<double> normal(0, 1);
  Eigen::Vector3d a(normal(random), normal(random), normal(random)), b(normal(random), normal(random), normal(random));
  Vector6d xi;
  xi << rho * a.normalized(), angle * b.normalized();
  return xi;
}

TEST(Jacobian, TemplateRowIsTheDerivativeOfTheWarp) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> uniform(0, 1);
  for (const Camera& camera : {Camera{300, 310, 158.3, 121.7, 320, 240}, Camera{481.2, -480, 319.5, 239.5, 640, 480},
                               Camera{-250, 260, 100, 90, 200, 160}, Camera{200, 150, 50, 60, 640, 480}.at_level(2)}) {
    for (int n = 0; n < 200; ++n) {
      internal::TemplatePixel p;
      p.u = static_cast<float>(std::floor(uniform(random) * camera.width));
      p.v = static_cast<float>(std::floor(uniform(random) * camera.height));
      p.inverse_depth = static_cast<float>(0.05 + 2 * uniform(random));
      p.gu = static_cast<float>(uniform(random) - 0.5);
      p.gv = static_cast<float>(uniform(random) - 0.5);
      const auto J = internal::jacobian(p, camera);
      Eigen::Matrix<double, 1, 6> numeric;
      for (int k = 0; k < 6; ++k) {
        const double h = 1e-6;
        const auto value = [&](double step) {  // the image whose gradient at u is (gu, gv): gu u + gv v
          Vector6d xi = Vector6d::Zero();
          xi(k) = step;
          const SE3 T = SE3::exp(xi);
          const Eigen::Vector3d X = T * (camera.ray({p.u, p.v}) / p.inverse_depth);
          const Eigen::Vector2d w = camera.project(X);
          return p.gu * w.x() + p.gv * w.y();
        };
        numeric(k) = (value(h) - value(-h)) / (2 * h);
      }
      ASSERT_LT((J - numeric).norm(), 1e-6 * (1 + numeric.norm())) << J << "\n" << numeric;
    }
  }
}

TEST(Jacobian, WarpMapsARayOfCamera0IntoCamera1) {
  std::mt19937 random(5);
  const Camera camera{300, -310, 158.3, 121.7, 320, 240};
  for (int n = 0; n < 100; ++n) {
    const SE3 T_10 = SE3::exp(random_twist(random, 0.3, 0.1));
    const Eigen::Vector2d uv(100 + n, 50 + n);
    const double z = 2;
    const auto w = internal::warp(camera, T_10, uv.x(), uv.y(), 1 / z);
    const Eigen::Vector2d expected = camera.project(T_10 * (z * camera.ray(uv)));
    EXPECT_NEAR(w.u, expected.x(), 1e-9);
    EXPECT_NEAR(w.v, expected.y(), 1e-9);
    EXPECT_EQ(w.visible, camera.contains(expected));
  }
  SE3 behind;
  behind.t.z() = -2;  // exactly in the camera plane
  EXPECT_FALSE(internal::warp(camera, behind, 160, 120, 0.5).visible);
  behind.t.z() = -5;
  EXPECT_FALSE(internal::warp(camera, behind, 160, 120, 0.5).visible);
}

// The sums against a plain loop over J and r, weights and invisible pixels included.
TEST(Jacobian, NormalEquationsAreTheSumsOfTheRows) {
  const Camera camera{40, 40, 15.5, 11.5, 32, 24};
  Map f0(32, 24), f1(32, 24);
  for (int v = 0; v < 24; ++v)
    for (int u = 0; u < 32; ++u) {
      f0.at(u, v) = static_cast<float>(0.5 + 0.3 * std::sin(0.4 * u + 0.3 * v));
      f1.at(u, v) = static_cast<float>(0.5 + 0.3 * std::sin(0.4 * u + 0.3 * v + 0.2));
    }
  Map q(32, 24);
  std::fill(q.data.begin(), q.data.end(), 0.5f);
  q.at(3, 3) = 0;
  const auto pixels = internal::dense_template(f0, q);
  Vector6d xi;
  xi << 0.3, -0.1, 0.1, 0.02, 0.01, 0.03;
  const internal::Point at{SE3::exp(xi), 1.2, -0.05};
  std::vector<float> weights(pixels.size());
  for (size_t k = 0; k < weights.size(); ++k) weights[k] = static_cast<float>(k % 3) / 2;
  const auto r = internal::residuals(pixels, f1, camera, at);
  internal::NormalSums expected;
  for (size_t k = 0; k < pixels.size(); ++k) {
    expected.masked += pixels[k].inverse_depth > 0;
    if (std::isnan(r[k])) continue;
    expected.visible += 1;
    internal::Vector8d J;
    J << internal::jacobian(pixels[k], camera).transpose(), pixels[k].f0, 1;
    expected.H += weights[k] * J * J.transpose();
    expected.g += weights[k] * r[k] * J;
    expected.cost += weights[k] * r[k] * r[k];
  }
  const auto sums = internal::normal_equations(pixels, f1, camera, at, weights);
  EXPECT_EQ(sums.masked, 32 * 24 - 1);
  EXPECT_EQ(sums.visible, expected.visible);
  EXPECT_GT(sums.visible, 300);
  EXPECT_LT(sums.visible, 32 * 24 - 50);
  EXPECT_LT((sums.H - expected.H).norm(), 1e-6 * expected.H.norm());
  EXPECT_LT((sums.g - expected.g).norm(), 1e-6 * expected.g.norm());
  EXPECT_NEAR(sums.cost, expected.cost, 1e-6 * expected.cost);
  // Correlation of f0 and the warped f1 = r + a f0 + b, weighted.
  double n = 0, s0 = 0, s1 = 0, s00 = 0, s01 = 0, s11 = 0;
  for (size_t k = 0; k < pixels.size(); ++k) {
    if (std::isnan(r[k])) continue;
    const double a = pixels[k].f0, b = r[k] + at.gain * a + at.bias, w = weights[k];
    n += w, s0 += w * a, s1 += w * b, s00 += w * a * a, s01 += w * a * b, s11 += w * b * b;
  }
  EXPECT_NEAR(sums.correlation(at), (s01 - s0 * s1 / n) / std::sqrt((s00 - s0 * s0 / n) * (s11 - s1 * s1 / n)), 1e-6);
}

TEST(SE3, ExpIsTheMatrixExponential) {
  std::mt19937 random(7);
  for (double angle : {0.0, 1e-12, 1e-9, 1e-6, 0.9e-5, 1.1e-5, 1e-4, 1e-2, 0.5, 2.0, 3.0, M_PI - 1e-6, M_PI, 4.0})
    for (int n = 0; n < 10; ++n) {
      const Vector6d xi = random_twist(random, 2, angle);
      Eigen::Matrix4d X = Eigen::Matrix4d::Zero();
      X.topLeftCorner<3, 3>() = hat(xi.tail<3>());
      X.topRightCorner<3, 1>() = xi.head<3>();
      const Eigen::Matrix4d expected = X.exp();
      EXPECT_LT((SE3::exp(xi).matrix() - expected).norm(), 1e-12) << angle;
    }
}

TEST(SE3, LogInvertsExpUpToPi) {
  std::mt19937 random(8);
  for (double angle : {0.0, 1e-12, 1e-9, 1e-6, 0.9e-4, 1.1e-4, 1e-2, 0.5, 2.0, 3.0, M_PI - 1e-3, M_PI - 1e-6})
    for (int n = 0; n < 20; ++n) {
      const Vector6d xi = random_twist(random, 2, angle);
      EXPECT_LT((SE3::exp(xi).log() - xi).norm(), 1e-8) << angle;  // near pi the quaternion's w carries 1e-16 of 1e-6
      EXPECT_NEAR(SE3::exp(xi).angle(), angle, 1e-8);
    }
  for (double angle : {M_PI - 1e-9, M_PI, M_PI + 1e-3})  // here the axis may come back with the other sign
    for (int n = 0; n < 20; ++n) {
      const SE3 T = SE3::exp(random_twist(random, 2, angle));
      const Vector6d xi = T.log();
      EXPECT_LE(xi.tail<3>().norm(), M_PI + 1e-12);
      EXPECT_LT((SE3::exp(xi).matrix() - T.matrix()).norm(), 1e-8) << angle;
    }
  EXPECT_EQ(SE3{}.log(), Vector6d::Zero());
}

TEST(SE3, ProductsInversesAndPoints) {
  std::mt19937 random(9);
  const SE3 A = SE3::exp(random_twist(random, 2, 1)), B = SE3::exp(random_twist(random, 1, 2));
  EXPECT_LT(((A * B).matrix() - A.matrix() * B.matrix()).norm(), 1e-14);
  EXPECT_LT(((A * A.inverse()).matrix() - Eigen::Matrix4d::Identity()).norm(), 1e-14);
  const Eigen::Vector3d X(1, 2, 3);
  EXPECT_LT((A * X - (A.matrix() * X.homogeneous()).head<3>()).norm(), 1e-14);
  EXPECT_LT((hat(X) * Eigen::Vector3d(4, -5, 6) - X.cross(Eigen::Vector3d(4, -5, 6))).norm(), 1e-14);
}

TEST(SE3, FromMatrixRefusesWhatIsNoPose) {
  std::mt19937 random(10);
  const Eigen::Matrix4d good = SE3::exp(random_twist(random, 2, 1)).matrix();
  const auto with = [&](auto change) {
    Eigen::Matrix4d M = good;
    change(M);
    return refusal([&] { (void)SE3::from_matrix(M); });
  };
  EXPECT_EQ(with([](auto&) {}), "accepted");
  EXPECT_NE(with([](auto& M) { M(1, 2) = kNaN; }).find("not finite"), std::string::npos);
  EXPECT_NE(with([](auto& M) { M(0, 3) = kInf; }).find("not finite"), std::string::npos);
  EXPECT_NE(with([](auto& M) { M(3, 0) = 0.1; }).find("0 0 0 1"), std::string::npos);
  EXPECT_NE(with([](auto& M) { M(3, 3) = 2; }).find("0 0 0 1"), std::string::npos);
  EXPECT_NE(with([](auto& M) { M.template topLeftCorner<3, 3>() *= 1.01; }).find("|R R^T - I| = 0.03"), std::string::npos);
  EXPECT_NE(with([](auto& M) { M.col(0) *= -1; }).find("det R = -1"), std::string::npos);
  EXPECT_NE(with([](auto& M) { M.template topLeftCorner<3, 3>().setZero(); }).find("not a rotation"), std::string::npos);
  Eigen::Matrix4d rough = good;
  rough(0, 0) += 2e-4;
  const SE3 T = SE3::from_matrix(rough);
  EXPECT_LT((T.R * T.R.transpose() - Eigen::Matrix3d::Identity()).norm(), 1e-14);
  EXPECT_LT((T.matrix() - good).norm(), 4e-4);
}

TEST(SE3, InverseRightJacobianIsTheDerivativeOfLog) {
  std::mt19937 random(11);
  for (double size : {1e-4, 0.01, 0.1, 0.4}) {
    const Vector6d xi = random_twist(random, size, size);
    const Matrix6d J = inverse_right_jacobian(xi);
    Matrix6d numeric;
    const double h = 1e-5;
    for (int k = 0; k < 6; ++k) {
      Vector6d d = Vector6d::Zero();
      d(k) = h;
      numeric.col(k) = ((SE3::exp(xi) * SE3::exp(d)).log() - (SE3::exp(xi) * SE3::exp(-d)).log()) / (2 * h);
    }
    EXPECT_LT((J - numeric).norm(), 1e-8 + 0.05 * std::pow(size, 4)) << size << "\n" << J - numeric;
    EXPECT_GT((numeric - Matrix6d::Identity()).norm(), 0.3 * size);  // the identity would not pass
  }
}

TEST(Weights, AreTheDerivativeOfTheirLossOverR) {
  const double s = 0.07;
  const auto loss = [&](Robust robust, double r) -> double {
    switch (robust) {
      case Robust::unit: return 0.5 * r * r;
      case Robust::huber: {
        const double c = 1.345 * s;
        return std::abs(r) <= c ? 0.5 * r * r : c * (std::abs(r) - 0.5 * c);
      }
      case Robust::tukey: {
        const double c = 4.685 * s, y = 1 - r * r / (c * c);
        return std::abs(r) <= c ? c * c / 6 * (1 - y * y * y) : c * c / 6;
      }
      case Robust::cauchy: {
        const double c = 2.3849 * s;
        return 0.5 * c * c * std::log1p(r * r / (c * c));
      }
    }
    return 0;
  };
  for (Robust robust : {Robust::unit, Robust::huber, Robust::tukey, Robust::cauchy}) {
    for (double r = -0.6; r < 0.6; r += 0.0173) {
      const double h = 1e-6, slope = (loss(robust, r + h) - loss(robust, r - h)) / (2 * h);
      EXPECT_NEAR(internal::robust_weight(robust, static_cast<float>(r), static_cast<float>(s)), slope / r, 1e-4)
          << static_cast<int>(robust) << " " << r;
    }
    EXPECT_EQ(internal::robust_weight(robust, 0, static_cast<float>(s)), 1);
  }
  const std::vector<float> r{0.01f, std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity()};
  for (Robust robust : {Robust::unit, Robust::huber, Robust::tukey, Robust::cauchy}) {
    const auto w = internal::robust_weights(robust, r, 0.1f);
    EXPECT_GT(w[0], 0.9f);
    EXPECT_EQ(w[1], 0);
    EXPECT_EQ(w[2], 0);
  }
}

TEST(Weights, ScaleIsTheMedianAbsoluteResidual) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const std::vector<float> odd{-3, 1, nan, 2, 5, -4}, even{-3, 1, 2, -4}, tiny{1e-6f, -1e-6f, 0}, none{nan, nan};
  EXPECT_FLOAT_EQ(internal::mad_scale(odd), 1.4826f * 3);
  EXPECT_FLOAT_EQ(internal::mad_scale(even), 1.4826f * 2);  // the lower median
  EXPECT_FLOAT_EQ(internal::mad_scale(tiny), 1e-3f);
  EXPECT_EQ(internal::mad_scale(none), 0);
  EXPECT_EQ(internal::mad_scale({}), 0);
  std::mt19937 random(12);
  std::normal_distribution<float> normal(0, 0.25f);
  std::vector<float> noise(20000);
  for (float& r : noise) r = normal(random);
  EXPECT_NEAR(internal::mad_scale(noise), 0.25, 0.01);
  for (size_t i = 0; i < noise.size(); i += 10) noise[i] *= 1000;  // a tenth of outliers hardly moves it
  EXPECT_NEAR(internal::mad_scale(noise), 0.28, 0.02);
}

TEST(Camera, LevelsAndSizesKeepTheRays) {
  const Camera camera{525, -520, 319.5, 239.5, 641, 483};
  for (int level = 0; level < 6; ++level) {
    const Camera c = camera.at_level(level);
    const double s = std::ldexp(1.0, level);
    EXPECT_EQ(c.width, 641 >> level);
    EXPECT_EQ(c.height, 483 >> level);
    for (const Eigen::Vector2d& uv : {Eigen::Vector2d(0, 0), Eigen::Vector2d(100.25, 400.5)}) {
      const Eigen::Vector2d at((uv.x() + 0.5) / s - 0.5, (uv.y() + 0.5) / s - 0.5);
      EXPECT_LT((c.ray(at) - camera.ray(uv)).norm(), 1e-12);
    }
  }
  const Camera half{500, 400, 99.5, 49.5, 200, 100};
  EXPECT_LT((half.resized(100, 50).ray({49.5, 24.5}) - half.ray({99.5, 49.5})).norm(), 1e-12);
  EXPECT_EQ(half.resized(100, 50).fx, half.at_level(1).fx);
  EXPECT_EQ(half.resized(100, 50).cx, half.at_level(1).cx);
  const Camera odd = half.resized(300, 70);
  EXPECT_LT((odd.ray({(10 + 0.5) * 1.5 - 0.5, (20 + 0.5) * 0.7 - 0.5}) - half.ray({10, 20})).norm(), 1e-12);
  EXPECT_EQ(odd.width, 300);
  EXPECT_EQ(odd.height, 70);
}

TEST(Camera, ProjectsItsRaysAndKnowsItsDerivative) {
  const Camera camera{525, -520, 319.5, 239.5, 640, 480};
  const Eigen::Vector2d uv(12.25, 345.75);
  EXPECT_EQ(camera.ray(uv).z(), 1);
  EXPECT_LT((camera.project(3.5 * camera.ray(uv)) - uv).norm(), 1e-12);
  EXPECT_GT(camera.project({0.1, 0, 1}).x(), camera.cx);
  EXPECT_LT(camera.project({0, 0.1, 1}).y(), camera.cy);  // fy < 0: v grows against Y
  const Eigen::Vector3d X(0.3, -0.7, 2.1);
  const auto J = camera.project_jacobian(X);
  for (int k = 0; k < 3; ++k) {
    Eigen::Vector3d d = Eigen::Vector3d::Zero();
    d(k) = 1e-6;
    const Eigen::Vector2d numeric = (camera.project(X + d) - camera.project(X - d)) / 2e-6;
    EXPECT_LT((J.col(k) - numeric).norm(), 1e-6);
  }
  EXPECT_TRUE(camera.contains({0, 0}));
  EXPECT_TRUE(camera.contains({639, 479}));
  EXPECT_FALSE(camera.contains({639.01, 100}));
  EXPECT_FALSE(camera.contains({-0.01, 100}));
  EXPECT_FALSE(camera.contains({100, 479.01}));
  EXPECT_FALSE(camera.contains({100, -0.01}));
  EXPECT_FALSE(camera.contains({kNaN, 1}));
}

TEST(Camera, CheckNamesTheValue) {
  const auto with = [](auto change) {
    Camera camera{525, -520, 319.5, 239.5, 640, 480};
    change(camera);
    return refusal([&] { camera.check(); });
  };
  EXPECT_EQ(with([](Camera&) {}), "accepted");
  EXPECT_EQ(with([](Camera& c) { c.fx = -525; }), "accepted");
  EXPECT_NE(with([](Camera& c) { c.fx = -5; }).find("too short for 640x480 pixels"), std::string::npos);
  EXPECT_NE(with([](Camera& c) { c.fx = 0; }).find("focal length fx,fy = 0,-520"), std::string::npos);
  EXPECT_NE(with([](Camera& c) { c.fy = 0; }).find("525,0"), std::string::npos);
  EXPECT_NE(with([](Camera& c) { c.cy = kNaN; }).find("nan"), std::string::npos);
  EXPECT_NE(with([](Camera& c) { c.fx = kInf; }).find("inf"), std::string::npos);
  EXPECT_NE(with([](Camera& c) { c.width = 0; }).find("0x480"), std::string::npos);
  EXPECT_NE(with([](Camera& c) { c.height = -3; }).find("640x-3"), std::string::npos);
}

}  // namespace
}  // namespace iclk
