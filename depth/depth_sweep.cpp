#include <iclk/depth/depth_sweep.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <string>

#include <Eigen/LU>

#include <iclk/depth/internal/buffers.h>
#include <iclk/depth/internal/speckles.h>
#include <iclk/depth/internal/stages.h>
#include <iclk/depth/internal/verdict.h>
#include <iclk/engine/compute/recorder.h>
#include <iclk/engine/error.h>
#include <iclk/shaders/depth/depth.h>

#include "census.comp.spv.h"
#include "consistent.comp.spv.h"
#include "corners.comp.spv.h"
#include "cost.comp.spv.h"
#include "median.comp.spv.h"
#include "path.comp.spv.h"
#include "polish.comp.spv.h"
#include "smooth.comp.spv.h"
#include "winner.comp.spv.h"

namespace iclk {
namespace {

using engine::BufferId;
using engine::BufferUse;
using engine::groups_for;
using engine::MemoryKind;
using internal::DepthBuffers;
using internal::DepthStrips;

constexpr uint32_t kGroup = 64;
// One invocation per path. Small groups, so that few paths still occupy many cores.
constexpr uint32_t kPathGroup = 32;
constexpr int kWays[ICLK_DEPTH_PATHS][2] = {{1, 0}, {-1, 0}, {0, 1}, {0, -1}, {1, 1}, {-1, 1}, {1, -1}, {-1, -1}};

[[noreturn]] void fail(const std::string& why) { throw Error(ErrorCode::invalid_argument, "depth: " + why); }

/// `middle` is the inverse depth of the plane on which the view's pixels are mapped back to the reference.
shaders::DepthView view_of(const Camera& reference, const DepthSource& source, double middle) {
  Eigen::Matrix3d K_1, K_0_inverse;
  const Camera& c = source.camera;
  K_1 << c.fx, 0, c.cx, 0, c.fy, c.cy, 0, 0, 1;
  K_0_inverse << 1 / reference.fx, 0, -reference.cx / reference.fx, 0, 1 / reference.fy, -reference.cy / reference.fy, 0, 0, 1;
  const Eigen::Matrix3f H = (K_1 * source.T_10.R * K_0_inverse).cast<float>();
  const Eigen::Vector3f e = (K_1 * source.T_10.t).cast<float>();
  const auto row = [&](int i) { return shaders::vec4{H(i, 0), H(i, 1), H(i, 2), e(i)}; };
  // A view beyond the plane would see its back; from a view in the plane nothing can be mapped back.
  const double ahead = -(source.T_10.R.transpose() * source.T_10.t).z(), w = ahead * middle > 0.5 ? 0.5 / ahead : middle;
  const Eigen::Matrix3d plane = source.T_10.R + w * source.T_10.t * Eigen::RowVector3d::UnitZ();
  const Eigen::Matrix3f back = (K_1 * plane * K_0_inverse).inverse().cast<float>();
  const auto back_row = [&](int i) { return shaders::vec4{back(i, 0), back(i, 1), back(i, 2), 0}; };
  return {row(0), row(1), row(2), back_row(0), back_row(1), back_row(2)};
}

}  // namespace

struct DepthSweep::Impl {
  Impl(std::shared_ptr<const engine::Context> c, const DepthPlan& p, const DepthOptions& o)
      : context(std::move(c)),
        plan((p.check(), p)),
        options((o.check(), o)),
        strips(internal::strips_of(*context, plan)),
        ids(plan, strips.rows, layout),
        memory(context, layout),
        quads(static_cast<uint32_t>(plan.planes) / ICLK_DEPTH_QUAD),
        submission(context),
        timer(context, 64 + 3 * static_cast<uint32_t>(strips.count(plan))) {
    using enum engine::BindingKind;
    constexpr uint32_t push = sizeof(shaders::DepthPush);
    const auto views = static_cast<uint32_t>(plan.views);
    engine::KernelBatch batch(context);
    batch.add(census, {"census", census_comp_spv, {texel_read, uniform, storage_write}, push, {kGroup}});
    batch.add(cost, {"cost", cost_comp_spv, {texel_read, texel_read, uniform, storage_write}, push, {kGroup, quads, views}});
    batch.add(path, {"path", path_comp_spv, {texel_read, texel_read, storage_write}, push, {kPathGroup, quads}});
    std::vector<engine::BindingKind> sums(ICLK_DEPTH_PATHS, texel_read);
    sums.insert(sums.end(), {uniform, storage_write, storage_read_write});
    batch.add(winner, {"winner", winner_comp_spv, sums, push, {kGroup, quads}});
    batch.add(consistent,
              {"consistent", consistent_comp_spv, {storage_read, storage_read, uniform, storage_write}, push, {kGroup}});
    batch.add(median, {"median", median_comp_spv, {texel_read, storage_write}, push, {kGroup}});
    batch.add(corners, {"corners", corners_comp_spv, {texel_read, storage_write}, push, {kGroup}});
    batch.add(polish,
              {"polish", polish_comp_spv, {texel_read, texel_read, uniform, storage_write, texel_read}, push, {kGroup}});
    batch.add(smooth, {"smooth", smooth_comp_spv, {texel_read, storage_write}, push, {kGroup}});
    batch.make();
    engine::ArenaSize size;
    size.add(path, ICLK_DEPTH_PATHS);
    size.add(polish, 2);
    size.add(smooth, 2);
    for (const engine::Kernel* kernel : {&census, &cost, &winner, &consistent, &median, &corners, &smooth}) size.add(*kernel);
    arena = std::make_unique<engine::DescriptorArena>(context, size);
  }

  size_t area() const { return static_cast<size_t>(plan.width) * static_cast<size_t>(plan.height); }

  size_t volume_bytes() const {
    return static_cast<size_t>(plan.width) * static_cast<size_t>(strips.rows) * static_cast<size_t>(plan.planes);
  }

  void check_image(const ImageView& image, const Camera& camera, const std::string& what) const {
    if (image.empty() || image.width != plan.width || image.height != plan.height)
      fail(what + " has " + std::to_string(image.width) + "x" + std::to_string(image.height) + " pixels, but the plan " +
           std::to_string(plan.width) + "x" + std::to_string(plan.height));
    camera.check();
    if (camera.width != plan.width || camera.height != plan.height)
      fail("the camera of " + what + " is for " + std::to_string(camera.width) + "x" + std::to_string(camera.height) +
           " pixels, not " + std::to_string(plan.width) + "x" + std::to_string(plan.height) + "; see Camera::resized()");
  }

  void check(const ImageView& reference, const Camera& camera, std::span<const DepthSource> sources) const {
    check_image(reference, camera, "the reference");
    if (sources.empty() || sources.size() > static_cast<size_t>(plan.views))
      fail(std::to_string(sources.size()) + " views, but the plan has room for 1 to " + std::to_string(plan.views));
    for (size_t i = 0; i < sources.size(); ++i) {
      const std::string what = "view " + std::to_string(i);
      check_image(sources[i].image, sources[i].camera, what);
      const SE3& T = sources[i].T_10;
      if (!T.t.allFinite() || !T.R.allFinite()) fail("the pose of " + what + " has NaN or infinite numbers");
      if (!(T.R * T.R.transpose()).isIdentity(1e-6) || T.R.determinant() < 0)
        fail("the pose of " + what + " is not a rotation and translation");
      if (T.t.norm() == 0) fail("the pose of " + what + " does not move the camera: without a baseline there is no depth");
    }
  }

  void write(const engine::Buffer& to, size_t image, const ImageView& from) const {
    const Map map = grey_map(from);
    std::memcpy(to.as<float>() + image * area(), map.data.data(), 4 * area());
  }

  void write_priors(const Features& priors, const shaders::DepthPush& push) const {
    float* out = memory[ids.priors].as<float>();
    std::fill(out, out + area(), -1.0f);
    for (size_t i = 0; i < priors.uv.size(); ++i) {
      const double u = std::round(priors.uv[i].x()), v = std::round(priors.uv[i].y()), w = priors.inverse_depth[i];
      if (!(u >= 0 && v >= 0 && u < plan.width && v < plan.height) || !(w > 0 && std::isfinite(w))) continue;
      const double plane = (w - static_cast<double>(push.first)) / static_cast<double>(push.step);
      if (plane >= 0 && plane <= plan.planes - 1)
        out[static_cast<size_t>(v) * static_cast<size_t>(plan.width) + static_cast<size_t>(u)] = static_cast<float>(plane);
    }
  }

  /// Records all steps from costs to winners, for the rows from `row` on.
  void record_strip(engine::Recorder& recorder, shaders::DepthPush push, int row) {
    const auto& m = memory;
    const int end = std::min(row + strips.answered, plan.height), above = std::max(row - DepthStrips::kOverlap, 0);
    const int below = strips.rows == plan.height ? plan.height : std::min(end + DepthStrips::kOverlap, plan.height);
    push.strip = static_cast<uint32_t>(strips.rows == plan.height ? 0 : above);
    push.rows = static_cast<uint32_t>(below) - push.strip;
    push.answered = static_cast<uint32_t>(row), push.answered_end = static_cast<uint32_t>(end);
    const auto groups_of = [&](uint32_t rows) { return engine::Groups{groups_for(push.width * rows, kGroup), 1, 1}; };
    recorder.stage("cost");
    recorder.dispatch(cost, {&m[ids.census], &m[ids.priors], &m[ids.views], &m[ids.costs]}, push, groups_of(push.rows));
    recorder.stage("paths");
    for (int i = 0; i < ICLK_DEPTH_PATHS; ++i) {
      push.du = kWays[i][0], push.dv = kWays[i][1];
      recorder.dispatch(path, {&m[ids.costs], &m[ids.grey], &m[ids.paths[i]]}, push,
                        {groups_for(push.dv == 0 ? push.rows : push.width, kPathGroup), 1, 1});
    }
    recorder.stage("winner");
    std::vector<const engine::Buffer*> sums;
    for (const BufferId id : ids.paths) sums.push_back(&m[id]);
    for (const BufferId id : {ids.views, ids.winners, ids.claims}) sums.push_back(&m[id]);
    recorder.dispatch(winner, sums, std::as_bytes(std::span(&push, 1)), groups_of(push.answered_end - push.answered));
  }

  void record(shaders::DepthPush push) {
    const auto pixels = static_cast<uint32_t>(area());
    const engine::Groups all{groups_for(pixels, kGroup), 1, 1};
    const auto& m = memory;
    engine::Recorder recorder(submission, *arena, &timer);
    recorder.stage("upload");
    for (const BufferId id : {ids.views, ids.grey, ids.priors}) recorder.upload(m[id], 0, m[id].size);
    recorder.fill(m[ids.claims], 0xffffffffu);
    recorder.stage("census");
    recorder.dispatch(corners, {&m[ids.grey], &m[ids.corners]}, push, {all.x, 1, push.views + 1});
    recorder.dispatch(census, {&m[ids.corners], &m[ids.views], &m[ids.census]}, push, {all.x, 1, push.views + 1});
    for (int row = 0; row < plan.height; row += strips.answered) record_strip(recorder, push, row);
    recorder.stage("consistent");
    recorder.dispatch(consistent, {&m[ids.winners], &m[ids.claims], &m[ids.views], &m[ids.raw_planes]}, push, all);
    recorder.stage("median");
    recorder.dispatch(median, {&m[ids.raw_planes], &m[ids.planes]}, push, all);
    recorder.stage("polish");
    BufferId from = ids.planes, to = ids.raw_planes;
    for (int i = 0; i < options.iterations; ++i, std::swap(from, to))
      recorder.dispatch(polish, {&m[ids.grey], &m[from], &m[ids.views], &m[to], &m[ids.corners]}, push, all);
    if (options.iterations > 0) {
      recorder.stage("smooth");
      recorder.dispatch(smooth, {&m[from], &m[to]}, push, all);
      std::swap(from, to);
    }
    recorder.stage("download");
    recorder.copy(m[ids.winners], m[ids.read_winners], 8 * area());
    recorder.copy(m[from], m[ids.read_planes], 4 * area());
    recorder.host_read({&m[ids.read_winners], &m[ids.read_planes]});
    recorder.finish();
  }

  DepthMap compute(const ImageView& reference, const Camera& camera, std::span<const DepthSource> sources,
                   const DepthRange& range, const Features& priors) {
    check(reference, camera, sources);
    range.check();
    shaders::DepthPush push{};
    push.width = static_cast<uint32_t>(plan.width), push.height = static_cast<uint32_t>(plan.height);
    push.views = static_cast<uint32_t>(sources.size());
    push.first = static_cast<float>(1 / range.far);
    push.step = static_cast<float>((1 / range.near - 1 / range.far) / (plan.planes - 1));
    if (!(push.step > 0) || !std::isfinite(push.step))
      fail("a range of depth from " + std::to_string(range.near) + " to " + std::to_string(range.far) +
           " m is too narrow or too near for single precision");
    push.p1 = static_cast<uint32_t>(options.p1), push.p2 = static_cast<uint32_t>(options.p2);
    push.edge = static_cast<float>(options.edge), push.uniqueness = static_cast<float>(options.uniqueness);
    push.tolerance = static_cast<float>(options.tolerance);
    push.keep_unseen = options.keep_unseen;

    auto* views = memory[ids.views].as<shaders::DepthViews>();
    *views = {};
    write(memory[ids.grey], 0, reference);
    for (size_t i = 0; i < sources.size(); ++i) {
      write(memory[ids.grey], i + 1, sources[i].image);
      views->view[i] = view_of(camera, sources[i], 0.5 * (1 / range.near + 1 / range.far));
    }
    write_priors(priors, push);
    record(push);
    submission.end();
    submission.submit_and_wait();
    timer.collect();

    DepthMap map{Map(plan.width, plan.height), Map(plan.width, plan.height)};
    const float* planes = memory[ids.read_planes].as<float>();
    for (size_t i = 0; i < area(); ++i) map.inverse_depth.data[i] = planes[i] >= 0 ? push.first + push.step * planes[i] : 0.0f;
    const float step = static_cast<float>(options.speckle_step) * push.step;
    if (options.speckle > 0) internal::drop_speckles(map.inverse_depth.data, plan.width, options.speckle, step);
    const float* winners = memory[ids.read_winners].as<float>();
    size_t valid = 0;
    for (size_t i = 0; i < area(); ++i) {
      float& w = map.inverse_depth.data[i];
      if (!(w > 0)) w = 0;
      map.confidence.data[i] = w > 0 ? winners[2 * i + 1] : 0.0f;
      valid += w > 0;
    }
    map.valid = static_cast<double>(valid) / static_cast<double>(area());
    map.seen = seen_by(*views, push);
    internal::judge(map);
    compare(map, priors, options.tolerance * static_cast<double>(push.step));
    return map;
  }

  /// The share of the reference's pixels that a view sees, averaged over the planes, on a grid of pixels.
  double seen_by(const shaders::DepthViews& views, const shaders::DepthPush& push) const {
    constexpr int kGrid = 16;
    int seen = 0;
    for (int i = 0; i < kGrid * kGrid * kGrid; ++i) {
      const auto part = [](int k) { return (k % kGrid + 0.5f) / kGrid; };
      const Eigen::Vector4f p(part(i) * static_cast<float>(plan.width), part(i / kGrid) * static_cast<float>(plan.height), 1,
                              push.first + push.step * part(i / (kGrid * kGrid)) * static_cast<float>(plan.planes - 1));
      const auto inside = [&](const shaders::DepthView& view) {
        const auto at = [&](const shaders::vec4& row) { return p.dot(Eigen::Map<const Eigen::Vector4f>(row.data())); };
        const float z = at(view.row_z), u = at(view.row_u) / z, v = at(view.row_v) / z;
        return z > 0 && u >= 0 && v >= 0 && u < static_cast<float>(plan.width) && v < static_cast<float>(plan.height);
      };
      seen += std::any_of(views.view, views.view + push.views, inside);
    }
    return static_cast<double>(seen) / (kGrid * kGrid * kGrid);
  }

  /// Copies a buffer of the device to the host, through temporary memory.
  template <class T>
  std::vector<T> read(BufferId id, size_t bytes) const {
    engine::MemoryPlan plan_of_one;
    const BufferId copy = plan_of_one.add("depth to look at", bytes, MemoryKind::readback, BufferUse::transfer);
    const engine::Workspace host(context, plan_of_one);
    engine::Submission once(context);
    engine::ArenaSize size;
    size.sets = 1, size.storage = 1;
    engine::DescriptorArena none(context, size);
    engine::Recorder recorder(once, none);
    recorder.copy(memory[id], host[copy], bytes);
    recorder.host_read({&host[copy]});
    recorder.finish();
    once.end();
    once.submit_and_wait();
    std::vector<T> out(bytes / sizeof(T));
    std::memcpy(out.data(), host[copy].mapped, bytes);
    return out;
  }

  std::shared_ptr<const engine::Context> context;
  DepthPlan plan;
  DepthOptions options;
  DepthStrips strips;
  engine::MemoryPlan layout;
  DepthBuffers ids;
  engine::Workspace memory;
  uint32_t quads;
  engine::Kernel census, cost, path, winner, consistent, median, corners, polish, smooth;
  std::unique_ptr<engine::DescriptorArena> arena;
  engine::Submission submission;
  engine::StageTimer timer;
};

DepthSweep::DepthSweep(std::shared_ptr<const engine::Context> context, const DepthPlan& plan, const DepthOptions& options)
    : impl_(std::make_unique<Impl>(std::move(context), plan, options)) {}
DepthSweep::~DepthSweep() = default;
DepthSweep::DepthSweep(DepthSweep&&) noexcept = default;
DepthSweep& DepthSweep::operator=(DepthSweep&&) noexcept = default;

engine::MemoryBytes DepthSweep::memory(const engine::Context& context, const DepthPlan& plan) {
  plan.check();
  engine::MemoryPlan layout;
  const DepthBuffers buffers(plan, internal::strips_of(context, plan).rows, layout);
  return layout.bytes(context);
}

DepthMap DepthSweep::compute(const ImageView& reference, const Camera& camera, std::span<const DepthSource> sources,
                             const DepthRange& range, const Features& priors) {
  return impl_->compute(reference, camera, sources, range, priors);
}

const DepthPlan& DepthSweep::plan() const { return impl_->plan; }
int DepthSweep::strips() const { return impl_->strips.count(impl_->plan); }
const std::vector<engine::StageTime>& DepthSweep::times() const { return impl_->timer.times(); }

namespace internal {

std::vector<uint8_t> DepthStages::volume(const DepthSweep& sweep) {
  return sweep.impl_->read<uint8_t>(sweep.impl_->ids.costs, sweep.impl_->volume_bytes());
}
std::vector<uint8_t> DepthStages::path(const DepthSweep& sweep, int index) {
  return sweep.impl_->read<uint8_t>(sweep.impl_->ids.paths[index], sweep.impl_->volume_bytes());
}
std::vector<uint32_t> DepthStages::census(const DepthSweep& sweep) {
  const DepthSweep::Impl& impl = *sweep.impl_;
  return impl.read<uint32_t>(impl.ids.census, 4 * impl.area() * (static_cast<size_t>(impl.plan.views) + 1));
}

}  // namespace internal
}  // namespace iclk
