#pragma once

namespace iclk {

/// "iclk 0.1.0 (4c51d24)": the release and the revision of the sources, with "-dirty" where they were changed since; "unknown"
/// where they were built outside git.
const char* version();

}  // namespace iclk
