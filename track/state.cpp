// Tracker::state() and restore().
#include <bit>
#include <utility>

#include <iclk/track/internal/archive.h>
#include <iclk/track/internal/tracker_impl.h>

namespace iclk {
namespace internal {

template <class Stream>
void archive(Stream& s, Features& f) {
  archive_all(s, f.uv, f.inverse_depth, f.inverse_depth_sigma);
}

template <class Stream>
void archive(Stream& s, FramePixels& p) {
  archive_all(s, p.time, p.image, p.mask, p.depth, p.features, p.format);
}

/// The parts that bundles use.
template <class Stream>
void archive(Stream& s, AlignedFeature& f) {
  archive_all(s, f.uv1, f.covariance, f.status);
}

template <class Stream>
void archive(Stream& s, TrackResult::Origin& o) {
  archive_all(s, o.keyframe, o.T_CK, o.confirmed, o.covariance);
}

template <class Stream>
void archive(Stream& s, Keyframe::Seed& seed) {
  archive_all(s, seed.uv, seed.filter.mean, seed.filter.sigma, seed.filter.a, seed.filter.b, seed.filter.range);
}

template <class Stream>
void archive(Stream& s, Place& p) {
  archive_all(s, p.T_WC, p.map);
}

template <class Stream>
void archive(Stream& s, Keyframe& k) {
  archive_all(s, k.id, k.slot, k.map, k.time, k.sharpness, k.T_WC, k.turn, k.turn_sigma, k.seen_turn, k.features, k.measured,
              k.sigma, k.with_depth, k.seeds, k.pixels, k.origin, k.sightings);
}

template <class Stream>
void archive(Stream& s, Motion::Last& l) {
  archive_all(s, l.time, l.T_WC);
}

template <class Stream>
void archive(Stream& s, Unroller::State::Turned& t) {
  archive_all(s, t.time, t.time_before, t.T_WC_before, t.turn, t.sigma);
}

}  // namespace internal

namespace {

constexpr uint64_t kMagic = 0x36304b4c43494b54;  // changes with the contents of a state

/// FNV-1a, 64 bits.
uint64_t checksum(std::span<const uint8_t> bytes) {
  uint64_t h = 0xcbf29ce484222325;
  for (const uint8_t b : bytes) h = (h ^ b) * 0x100000001b3;
  return h;
}

template <class Stream>
void archive_tracker(Stream& s, Tracker::Impl& m, std::map<int, internal::Keyframe>& held, std::vector<internal::Place>& places,
                     int& map) {
  internal::Motion& motion = m.motion;
  internal::Unroller::State& turn = m.unroller.state;
  internal::archive_all(s, held, places, map, m.locator.state.current, motion.last, m.previous.pixels, m.previous.rate,
                        m.previous.origin, motion.velocity, motion.seconds, turn.rate, turn.bent.turn, turn.bent.sigma,
                        turn.bent.seen, turn.turned, motion.lost, m.unplaced, m.maps, m.frames_lost, m.locator.state.next_tried,
                        m.places.state.next_tried, m.last_time);
  turn.changes.archive([&](auto&... values) { internal::archive_all(s, values...); });
  turn.readout.archive([&](auto&... values) { internal::archive_all(s, values...); });
}

}  // namespace

std::vector<uint8_t> Tracker::state() const {
  Impl& m = *impl_;  // not const: archive() is the same function for reading and writing
  internal::Writer writer;
  uint64_t magic = kMagic, sum = 0;
  internal::archive_all(writer, magic, sum, m.camera.width, m.camera.height, m.options.keyframes);
  std::vector<internal::Place> places = m.keyframes.places();
  int map = m.keyframes.current_map();
  archive_tracker(writer, m, m.keyframes.all(), places, map);
  sum = checksum(std::span(writer.bytes).subspan(2 * sizeof(uint64_t)));
  std::memcpy(writer.bytes.data() + sizeof(magic), &sum, sizeof(sum));
  return std::move(writer.bytes);
}

void Tracker::restore(std::span<const uint8_t> state) {
  const auto require = [](bool good, const char* what) {
    if (!good) throw Error(ErrorCode::invalid_argument, what);
  };
  internal::Reader reader(state);
  uint64_t magic = 0, sum = 0;
  int width = 0, height = 0, capacity = 0;
  internal::archive_all(reader, magic, sum);
  require(magic == kMagic, "not a saved tracker state, or one of another version");
  require(sum == checksum(state.subspan(2 * sizeof(uint64_t))), "the saved tracker state is damaged");
  internal::archive_all(reader, width, height, capacity);
  Impl& m = *impl_;
  require(width == m.camera.width && height == m.camera.height && capacity == m.options.keyframes,
          "the saved tracker state is for another camera or number of keyframes");
  auto fresh = std::make_unique<Impl>(m.aligner, m.camera, m.options);
  std::map<int, internal::Keyframe> held;
  std::vector<internal::Place> places;
  int map = 0;
  archive_tracker(reader, *fresh, held, places, map);
  require(reader.left() == 0, "the saved tracker state is too long");
  fresh->keyframes.restore(std::move(held), std::move(places), map);
  try {
    for (const auto& [id, k] : fresh->keyframes.all()) fresh->keyframes.prepare(k);
  } catch (...) {
    for (const auto& [id, k] : m.keyframes.all()) m.keyframes.prepare(k);  // their slots were overwritten
    throw;
  }
  fresh->learned = std::move(m.learned);
  impl_ = std::move(fresh);
}

}  // namespace iclk
