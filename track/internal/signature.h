#pragma once
#include <span>
#include <vector>

#include <iclk/align/pyramid.h>
#include <iclk/align/search/matching.h>

namespace iclk::internal {

/// What an image looks like: the descriptors of the start search at some of its features.
using Signature = std::vector<MatchDescriptor>;

/// `grey` is level 0.
Signature signature_of(const Map& grey, std::span<const Eigen::Vector2d> uv);

/// How alike two images are, 0 to 1: the share of descriptors of `a` that are each other's best match with one of `b` and
/// alike.
double likeness(const Signature& a, const Signature& b);

}  // namespace iclk::internal
