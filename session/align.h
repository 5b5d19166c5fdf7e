#pragma once
#include <optional>

#include <iclk/session/session.h>

namespace iclk {

/// Aligns one pair: chooses features where the reference has depth, looks for a start, asks one model after the other, refines,
/// and judges the result. The answer is that of `iclk align`, to the bit. Arguments and errors are those of
/// Session::align() and Session's constructor.
///
/// Nothing stays warm: each call reads the models and opens the device, which takes a second. A Session aligns many pairs.
Answer align(const ImageView& reference, const ImageView& depth, const ImageView& target, const Camera& camera,
             const SessionOptions& options = {}, const std::optional<SE3>& T_10 = {});
/// The same with features of the caller's.
Answer align(const Reference& reference, const ImageView& target, const SessionOptions& options = {},
             const std::optional<SE3>& T_10 = {});

}  // namespace iclk
