#include "apps/iclk/common/progress.h"

#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "apps/json/format.h"

namespace iclk {
std::string duration_text(double seconds) {
  const long s = std::lround(std::clamp(seconds, 0.0, 1e9));
  if (s < 60) return formatted("%ld s", s);
  if (s < 3600) return formatted("%ld min %ld s", s / 60, s % 60);
  return formatted("%ld h %ld min", s / 3600, s % 3600 / 60);
}

std::string progress_text(const ProgressState& state, int columns) {
  const int done = state.before + state.done;
  const double share = state.total > 0 ? static_cast<double>(done) / state.total : 1;
  std::string text = formatted(" %d/%d  %.1f %%", done, state.total, std::floor(1000 * share) / 10);
  if (state.done > 0 && state.seconds > 0) {
    const double rate = state.done / state.seconds;
    text += formatted(rate < 10 ? "  %.2f %s/s" : "  %.0f %s/s", rate, state.unit);
    if (done < state.total) text += "  " + duration_text((state.total - done) / rate) + " left";
  }
  if (state.failed > 0) text += formatted("  %d %s", state.failed, state.bad);
  const int bar = std::min(40, columns - 2 - static_cast<int>(text.size()));
  if (bar < 4) return text.substr(1, static_cast<size_t>(std::max(columns, 1)));
  const auto filled = static_cast<size_t>(std::floor(share * bar));
  std::string drawn(filled, '=');
  if (filled < static_cast<size_t>(bar)) drawn += '>';
  drawn.resize(static_cast<size_t>(bar), ' ');
  return "[" + drawn + "]" + text;
}

ProgressBar::ProgressBar() : terminal_(::isatty(STDERR_FILENO) == 1), next_(Clock::now()) {
  if (!terminal_) next_ += std::chrono::seconds(10);
}

void ProgressBar::show(const ProgressState& state) {
  const auto now = Clock::now();
  if (now < next_) return;
  next_ = now + (terminal_ ? std::chrono::milliseconds(100) : std::chrono::milliseconds(10000));
  if (!terminal_) {
    std::fprintf(stderr, "%s\n", progress_text(state, 0x7fff).substr(43).c_str());
    return;
  }
  winsize window = {};
  const int columns = ::ioctl(STDERR_FILENO, TIOCGWINSZ, &window) == 0 && window.ws_col > 0 ? window.ws_col : 80;
  std::fprintf(stderr, "\r%s\x1b[K", progress_text(state, columns - 1).c_str());
  std::fflush(stderr);
  drawn_ = true;
}

void ProgressBar::clear() {
  if (drawn_) std::fputs("\r\x1b[K", stderr);
  std::fflush(stderr);
  drawn_ = false;
  if (terminal_) next_ = Clock::now();
}

Progress terminal_progress() {
  if (!isatty(STDERR_FILENO)) return [](const std::string&, int, int) {};
  return [](const std::string& what, int done, int total) {
    constexpr int kWidth = 30;
    const int filled = total > 0 ? kWidth * done / total : 0;
    if (done >= total)
      std::fprintf(stderr, "\r\x1b[K");
    else
      std::fprintf(stderr, "\r\x1b[K[%s%s] %d/%d %s", std::string(static_cast<size_t>(filled), '#').c_str(),
                   std::string(static_cast<size_t>(kWidth - filled), '.').c_str(), done, total, what.c_str());
    std::fflush(stderr);
  };
}

}  // namespace iclk
