#pragma once
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

namespace iclk {

/// Calls make(index) for each of `todo`, and what it returns beside the making of the next one: views are encoded and written
/// while others are rendered. Shows progress, in `unit`s, `total` being all that there will be. Seconds that it took.
double render_each(const char* unit, const std::vector<uint64_t>& todo, uint64_t total,
                   const std::function<std::function<void()>(uint64_t)>& make);

/// Says what is to be rendered and what it can take; `room`: bytes for one of `what`. Throws Error(io) for a disk that is too
/// small.
void check_disk(const std::string& folder, const std::string& what, uint64_t count, uint64_t room, const std::string& remedy);

}  // namespace iclk
