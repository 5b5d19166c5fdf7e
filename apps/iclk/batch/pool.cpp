#include "apps/iclk/batch/pool.h"

#include <algorithm>
#include <new>

namespace iclk {
namespace {

size_t bytes_of(const DecodedPair& item) {
  const auto pixels = [](const cv::Mat& image) { return image.empty() ? 0 : image.total() * image.elemSize(); };
  return pixels(item.pair.image_0) + pixels(item.pair.image_1) + pixels(item.pair.depth_0) + pixels(item.pair.mask_1) +
         item.pair.features.uv.size() * (sizeof(Eigen::Vector2d) + 2 * sizeof(double));
}

/// A plan on the device has one size and one format, and masks or none.
bool same_kind(const DecodedPair& a, const DecodedPair& b) {
  if (!a.error.empty() || !b.error.empty()) return a.error.empty() == b.error.empty();
  return a.pair.image_0.size() == b.pair.image_0.size() && a.pair.image_0.type() == b.pair.image_0.type() &&
         a.pair.image_1.type() == b.pair.image_1.type() && a.pair.mask_1.empty() == b.pair.mask_1.empty();
}

}  // namespace

DecodePool::DecodePool(std::span<const ManifestLine* const> lines, Decode decode, const PoolLimits& limits, Measure measure)
    : lines_(lines), measure_(std::move(measure)), decode_(std::move(decode)), limits_(limits) {
  try {
    for (int i = 0; i < limits_.threads; ++i) threads_.emplace_back([this] { work(); });
  } catch (...) {
    stop();
    throw;
  }
}

DecodePool::~DecodePool() { stop(); }

bool DecodePool::may_begin() const {
  const bool idle_thread = decoding_ + static_cast<int>(waiting_.size()) < limits_.threads;
  return idle_thread && !stopped_ && next_ < lines_.size() && held_ < limits_.pairs && (bytes_ < limits_.bytes || held_ == 0);
}

/// Waits until what decoding takes is free. A pair that waits is not being decoded: fill() gives out what is there, and what is
/// taken back of that is what it waits for.
DecodedPair DecodePool::decode(const ManifestLine& line, size_t& reserved) {
  const size_t bytes = measure_(line);
  {
    std::unique_lock lock(mutex_);
    const auto place = waiting_.insert(bytes);
    --decoding_;
    changed_.notify_all();
    changed_.wait(lock, [&] { return stopped_ || fits(bytes); });
    waiting_.erase(place);
    ++decoding_;
    if (stopped_) return {};
    bytes_ += reserved = bytes;
  }
  return decode_(line);
}

void DecodePool::work() {
  for (;;) {
    size_t index = 0;
    {
      std::unique_lock lock(mutex_);
      changed_.wait(lock, [&] { return stopped_ || next_ == lines_.size() || may_begin(); });
      if (stopped_ || next_ == lines_.size()) return;
      index = next_++;
      ++decoding_;
      ++held_;
    }
    DecodedPair item;
    size_t reserved = 0;
    try {
      item = decode(*lines_[index], reserved);
    } catch (const std::bad_alloc&) {
      item.error = "not enough memory to read this pair; give a smaller --memory or fewer --threads";
    } catch (const std::exception& e) {
      item.error = e.what();
      if (item.error.empty()) item.error = "unknown error";
    }
    item.line = lines_[index];
    item.bytes = bytes_of(item);
    {
      const std::lock_guard lock(mutex_);
      --decoding_;
      bytes_ += item.bytes - reserved;
      ready_.emplace(index, std::move(item));
    }
    changed_.notify_all();
  }
}

bool DecodePool::fill(PairGroup& group, int count) {
  if (ready_.empty()) return false;
  const auto failed = std::find_if(ready_.begin(), ready_.end(), [](const auto& entry) { return !entry.second.error.empty(); });
  const auto first = failed != ready_.end() ? failed : ready_.begin();
  std::vector<size_t> indices;
  for (auto it = first; it != ready_.end() && static_cast<int>(indices.size()) < count; ++it)
    if (same_kind(first->second, it->second)) indices.push_back(it->first);
  const bool more_may_come = decoding_ > 0 || may_begin() || (!waiting_.empty() && fits(*waiting_.begin()));
  if (failed == ready_.end() && static_cast<int>(indices.size()) < count && more_may_come) return false;
  for (const size_t index : indices) group.items.push_back(std::move(ready_.extract(index).mapped()));
  return true;
}

void DecodePool::free(PairGroup& group) {
  for (const DecodedPair& item : group.items) bytes_ -= item.bytes;
  held_ -= static_cast<int>(group.items.size());
  group.items.clear();
}

void DecodePool::next(PairGroup& group, int count, std::chrono::milliseconds patience) {
  std::unique_lock lock(mutex_);
  free(group);
  changed_.notify_all();
  changed_.wait_for(lock, patience, [&] { return fill(group, count) || done(); });
}

bool DecodePool::done() const { return next_ == lines_.size() && decoding_ == 0 && waiting_.empty() && ready_.empty(); }

bool DecodePool::finished() const {
  const std::lock_guard lock(mutex_);
  return done();
}

void DecodePool::stop() {
  {
    const std::lock_guard lock(mutex_);
    stopped_ = true;
  }
  changed_.notify_all();
  for (std::thread& thread : threads_)
    if (thread.joinable()) thread.join();
}

}  // namespace iclk
