#pragma once
#include <chrono>
#include <functional>
#include <string>

namespace iclk {

/// Where a long run stands.
struct ProgressState {
  int total = 0;       ///< pairs of this run and shard, those of earlier runs included
  int before = 0;      ///< done by earlier runs
  int done = 0;        ///< done by this run
  int failed = 0;      ///< of these
  double seconds = 0;  ///< that this run has taken
  const char* unit = "pairs";
  const char* bad = "failed";  ///< what `failed` ones are called
};

/// "[=====>    ] 123/500  24.6 %  12.3 pairs/s  31 s left  2 failed", at most `columns` wide.
std::string progress_text(const ProgressState& state, int columns);
/// "45 s", "3 min 20 s", "2 h 5 min".
std::string duration_text(double seconds);

/// Shows progress on standard error: a bar that is drawn over and over on a terminal, else a line every 10 s.
class ProgressBar {
 public:
  ProgressBar();
  void show(const ProgressState& state);
  /// Removes the bar, so that other text can be printed; the next show() draws it again.
  void clear();

 private:
  using Clock = std::chrono::steady_clock;
  bool terminal_ = false, drawn_ = false;
  Clock::time_point next_;
};

/// Told after every step of a long run: what is done now, steps done, steps in all.
using Progress = std::function<void(const std::string& what, int done, int total)>;

/// A bar on standard error, redrawn in place; nothing where standard error is no terminal.
Progress terminal_progress();

}  // namespace iclk
