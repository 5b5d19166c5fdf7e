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
void archive(Stream& s, MatchDescriptor& d) {
  for (float& value : d) archive(s, value);
}

template <class Stream>
void archive(Stream& s, BundleEdge& e) {
  archive_all(s, e.from, e.to, e.T_to_from, e.covariance);
}

template <class Stream>
void archive(Stream& s, Reach::Break& b) {
  archive_all(s, b.from, b.to, b.left, b.way, b.away, b.beyond, b.most);
}

template <class Stream>
void archive(Stream& s, Place& p) {
  archive_all(s, p.T_WC, p.map);
}

template <class Stream>
void archive(Stream& s, Keyframe& k) {
  archive_all(s, k.id, k.slot, k.map, k.time, k.used, k.way, k.signature, k.sharpness, k.T_WC, k.turn, k.turn_sigma,
              k.seen_turn, k.features, k.measured, k.sigma, k.with_depth, k.seeds, k.pixels, k.origin, k.sightings);
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

constexpr uint64_t kMagic = 0x37304b4c43494b54;  // changes with the contents of a state

/// FNV-1a, 64 bits.
uint64_t checksum(std::span<const uint8_t> bytes) {
  uint64_t h = 0xcbf29ce484222325;
  for (const uint8_t b : bytes) h = (h ^ b) * 0x100000001b3;
  return h;
}

template <class Stream>
void archive_tracker(Stream& s, Tracker::Impl& m, std::map<int, internal::Keyframe>& held,
                     std::map<int, internal::Keyframe>& archived, std::vector<internal::Place>& places, int& map) {
  internal::Motion& motion = m.motion;
  internal::Unroller::State& turn = m.unroller.state;
  internal::archive_all(s, held, archived, places, map, m.locator.state.current, motion.last, m.previous.pixels,
                        m.previous.rate, m.previous.origin, motion.velocity, motion.seconds, turn.rate, turn.bent.turn,
                        turn.bent.sigma, turn.bent.seen, turn.turned, motion.lost, m.unplaced, m.maps, m.way, m.frames_tracked,
                        m.frames_lost, m.loops.state.motions, m.loops.state.loops, m.loops.state.waiting, m.last_time,
                        m.keyframes.clock, m.reach.state.speed, m.reach.state.repeats, m.reach.state.breaks);
  turn.changes.archive([&](auto&... values) { internal::archive_all(s, values...); });
  turn.readout.archive([&](auto&... values) { internal::archive_all(s, values...); });
}

void require(bool good, const char* what) {
  if (!good) throw Error(ErrorCode::invalid_argument, what);
}

constexpr const char* kBroken = "the saved tracker state contradicts itself";
constexpr int kMostMaps = 1 << 30;

bool same(const Camera& a, const Camera& b) {
  return a.width == b.width && a.height == b.height && a.fx == b.fx && a.fy == b.fy && a.cx == b.cx && a.cy == b.cy;
}

void check(const SE3& T) {
  require(T.R.allFinite() && T.t.allFinite() && (T.R.transpose() * T.R - Eigen::Matrix3d::Identity()).norm() < 1e-6, kBroken);
}

void check(const internal::FramePixels& p, const Camera& camera) {
  const size_t area = static_cast<size_t>(camera.width) * static_cast<size_t>(camera.height);
  require(p.format >= PixelFormat::r8 && p.format <= PixelFormat::rgba32f && p.image.size() == area * bytes_per_pixel(p.format),
          kBroken);
  require((p.mask.empty() || p.mask.size() == area) && (p.depth.empty() || p.depth.size() == area), kBroken);
  require(!p.features || p.features->inverse_depth.size() == p.features->uv.size(), kBroken);
}

/// A keyframe of a state that may come from anywhere.
void check(const internal::Keyframe& k, size_t keyframes, const Camera& camera, const TrackerOptions& options) {
  const size_t n = k.features.uv.size();
  require(n <= static_cast<size_t>(options.features), "the saved tracker state has keyframes with more features");
  require(n > 0 && k.features.inverse_depth.size() == n && k.measured.size() == n && k.sigma.size() == n, kBroken);
  require(k.features.inverse_depth_sigma.empty() || k.features.inverse_depth_sigma.size() == n, kBroken);
  for (size_t i = 0; i < n; ++i)
    require(internal::inside(camera, k.features.uv[i], 0) && k.features.inverse_depth[i] > 0 &&
                std::isfinite(k.features.inverse_depth[i]),
            kBroken);
  for (const internal::Keyframe::Seed& seed : k.seeds) require(internal::inside(camera, seed.uv, ICLK_PATCH), kBroken);
  check(k.T_WC);
  check(k.pixels, camera);
  const auto known = [&](int id) { return id >= 0 && static_cast<size_t>(id) < keyframes; };
  require(known(k.id) && (!k.origin || known(k.origin->keyframe)), kBroken);
  for (const auto& [id, features] : k.sightings) require(known(id) && features.size() <= n, kBroken);
}

/// Frames are counted from 0; nobody tracks more than 2^53.
bool is_count(int64_t frames) { return frames >= 0 && frames <= int64_t{1} << 53; }

/// Checks what indices, sizes and numbers a damaged or malicious state could break.
void check(const Tracker::Impl& m) {
  const auto& places = m.keyframes.places();
  for (const int64_t frames : {m.keyframes.clock, m.frames_tracked, m.frames_lost}) require(is_count(frames), kBroken);
  require(m.maps > 0 && m.maps <= kMostMaps, kBroken);
  for (const internal::Place& place : places) {
    check(place.T_WC);
    require(place.map >= 0 && place.map < m.maps, kBroken);
  }
  require(m.keyframes.current_map() >= 0 && m.keyframes.current_map() < m.maps, kBroken);
  std::vector<bool> taken(static_cast<size_t>(m.options.keyframes));
  for (const auto& [id, k] : m.keyframes.all()) {
    require(k.id == id && k.slot >= 0 && k.slot < m.options.keyframes && !taken[static_cast<size_t>(k.slot)], kBroken);
    taken[static_cast<size_t>(k.slot)] = true;
    for (const auto& [seen_in, features] : k.sightings) require(m.keyframes.all().count(seen_in) > 0, kBroken);
  }
  require(m.keyframes.archived().empty() || !m.keyframes.empty(), kBroken);
  for (const auto& [id, k] : m.keyframes.archived()) require(k.id == id && k.sightings.empty() && k.seeds.empty(), kBroken);
  m.keyframes.each([&](const internal::Keyframe& k) {
    check(k, places.size(), m.camera, m.options);
    require(k.used >= 0 && k.used <= m.keyframes.clock, kBroken);  // else the newest keyframe could leave first
    require(k.map == places[static_cast<size_t>(k.id)].map, kBroken);
  });
  const auto known = [&](int id) { return id >= 0 && static_cast<size_t>(id) < places.size(); };
  for (const auto* edges : {&m.loops.state.motions, &m.loops.state.loops, &m.loops.state.waiting})
    for (const internal::BundleEdge& e : *edges) {
      require(known(e.from) && known(e.to), kBroken);
      check(e.T_to_from);
      require(e.covariance.allFinite(), kBroken);
    }
  const auto& breaks = m.reach.state.breaks;
  for (const internal::Reach::Break& b : breaks)
    require(known(b.from) && (known(b.to) || (b.to == -1 && &b == &breaks.back())), kBroken);
  require(m.motion.last.has_value() == !m.keyframes.empty(), kBroken);
  if (!m.motion.last) return;
  require(known(m.locator.state.current), kBroken);
  check(m.motion.last->T_WC);
  check(m.previous.pixels, m.camera);
  if (m.unplaced) check(*m.unplaced, m.camera);
}

}  // namespace

std::vector<uint8_t> Tracker::state() const {
  Impl& m = *impl_;  // not const: archive() is the same function for reading and writing
  internal::Writer writer;
  uint64_t magic = kMagic, sum = 0;
  internal::archive_all(writer, magic, sum, m.camera.width, m.camera.height, m.camera.fx, m.camera.fy, m.camera.cx, m.camera.cy,
                        m.options.keyframes);
  std::vector<internal::Place> places = m.keyframes.places();
  int map = m.keyframes.current_map();
  std::map<int, internal::Keyframe> archived = m.keyframes.archived();
  archive_tracker(writer, m, m.keyframes.all(), archived, places, map);
  sum = checksum(std::span(writer.bytes).subspan(2 * sizeof(uint64_t)));
  std::memcpy(writer.bytes.data() + sizeof(magic), &sum, sizeof(sum));
  return std::move(writer.bytes);
}

void Tracker::restore(std::span<const uint8_t> state) {
  internal::Reader reader(state);
  uint64_t magic = 0, sum = 0;
  Camera camera;
  int capacity = 0;
  internal::archive_all(reader, magic, sum);
  require(magic == kMagic, "not a saved tracker state, or one of another version");
  require(sum == checksum(state.subspan(2 * sizeof(uint64_t))), "the saved tracker state is damaged");
  internal::archive_all(reader, camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy, capacity);
  Impl& m = *impl_;
  require(same(camera, m.camera) && capacity == m.options.keyframes,
          "the saved tracker state is for another camera or number of keyframes");
  auto fresh = std::make_unique<Impl>(m.aligner, m.camera, m.options);
  std::map<int, internal::Keyframe> held, archived;
  std::vector<internal::Place> places;
  int map = 0;
  archive_tracker(reader, *fresh, held, archived, places, map);
  require(reader.left() == 0, "the saved tracker state is too long");
  fresh->keyframes.restore(std::move(held), std::move(archived), std::move(places), map);
  check(*fresh);
  try {
    for (const auto& [id, k] : fresh->keyframes.all()) fresh->keyframes.prepare(k);
  } catch (...) {
    for (const auto& [id, k] : m.keyframes.all()) m.keyframes.prepare(k);  // their slots were overwritten
    throw;
  }
  fresh->learned = std::move(m.learned);
  impl_ = std::move(fresh);
}

void Tracker::start_in(std::span<const uint8_t> state) {
  restore(state);
  Impl& m = *impl_;
  m.motion.lose();
  m.unroller.lose();
  m.unplaced.reset();
  m.reach.move_freely();
  m.last_time.reset();
  m.frames_lost = 2;  // no pose is expected
}

}  // namespace iclk
