#pragma once
#include <string>
#include <string_view>

#include <iclk/align/features.h>

namespace iclk {

/// Loads a feature file: a header line `u,v,depth[,sigma]` or `u,v,inverse_depth[,sigma]`, then one feature per line. Columns
/// may have any order, and other columns are ignored. Lines that begin with '#' are comments. `sigma` is the standard deviation
/// of the depth or inverse depth, in the same unit. Features with nan or inf are kept; set_reference() rejects them with a
/// verdict. Throws Error(io) for an unreadable file, else Error(invalid_argument) "`file`:`line`: ...".
Features load_features(const std::string& path);
/// Parses the text of a feature file; messages call the file `name`.
Features parse_features(std::string_view text, const std::string& name);

/// The text of a feature file with the columns u,v,depth.
std::string features_csv(const Features& features);

}  // namespace iclk
