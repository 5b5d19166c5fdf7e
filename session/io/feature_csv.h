#pragma once
#include <string>
#include <string_view>

#include <iclk/align/features.h>

namespace iclk {

/// A feature file: a header line `u,v,depth[,sigma]` or `u,v,inverse_depth[,sigma]`, then a feature a line. Columns may stand
/// in any order; others are ignored; '#' opens a comment line. `sigma` is the standard deviation of the column that gives the
/// depth, in its unit. A value may be nan or inf: the feature is then kept and rejected later, with a verdict.
/// Throws Error(io) for an unreadable file, Error(invalid_argument) "<file>:<line>: ..." otherwise.
Features load_features(const std::string& path);
/// Of the text of such a file; `name` stands for the file in messages.
Features parse_features(std::string_view text, const std::string& name);

/// The text of such a file: u,v,depth.
std::string features_csv(const Features& features);

}  // namespace iclk
