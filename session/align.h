#pragma once
#include <optional>

#include <iclk/session/session.h>

namespace iclk {

/// Aligns one pair, with the same steps as `iclk align` and a bit-identical result: chooses features where the reference has
/// depth, searches for a start, aligns with one model after the other, refines, and judges the result. Arguments and errors are
/// those of Session::align() and Session's constructor.
///
/// Each call reads the models and opens the device, which takes about a second. Use a Session for many pairs.
Answer align(const ImageView& reference, const ImageView& depth, const ImageView& target, const Camera& camera,
             const SessionOptions& options = {}, const std::optional<SE3>& T_10 = {});
/// The same, with given features.
Answer align(const Reference& reference, const ImageView& target, const SessionOptions& options = {},
             const std::optional<SE3>& T_10 = {});

}  // namespace iclk
