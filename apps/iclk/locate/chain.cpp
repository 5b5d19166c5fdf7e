#include "apps/iclk/locate/chain.h"

#include <filesystem>

#include <iclk/align/common/stopwatch.h>
#include <iclk/engine/error.h>
#include <iclk/locate/sequence_locator.h>
#include <iclk/session/io/output.h>

#include "apps/iclk/common/refuse.h"
#include "apps/iclk/io/images.h"
#include "apps/iclk/locate/picture.h"

namespace iclk {
namespace {

namespace fs = std::filesystem;

void set_pose(const SequencePose& pose, LocatedFrame& frame) {
  frame.located = pose.located;
  frame.tracked = pose.known && !pose.located.converged();
  if (!pose.known) return;
  frame.located.T_WC = pose.T_WC, frame.located.covariance = pose.covariance;
}

class Chain {
 public:
  Chain(const LocateRun& run, Locator& locator) : run_(run), locator_(locator) {}

  LocatedFrame add(const LocateFrame& frame, const cv::Mat& image) {
    const LocatePicture picture(run_, image);
    if (!sequence_) start(picture);
    if (picture.camera.width != camera_.width || picture.camera.height != camera_.height)
      refuse(frame.image + " has another size than the frames before; a sequence needs one camera");
    LocatedFrame result;
    result.image = frame.image, result.time = frame.time, result.camera = picture.camera;
    const internal::Stopwatch time;
    LocatorFrame next{frame.time, view(picture.image), view(picture.seen), {}};
    if (!frame.follows) next.prior = frame.prior;
    const SequencePose pose = sequence_->locate(next);
    result.ms = time.ms();
    set_pose(pose, result);
    if (result.located.converged())
      write_file((fs::path(run_.out) / "overlay" / frame.overlay).string(), draw_located(picture, locator_, result));
    return result;
  }

  std::vector<SequencePose> all() { return sequence_ ? sequence_->all() : std::vector<SequencePose>(); }

 private:
  void start(const LocatePicture& picture) {
    camera_ = picture.camera;
    SequenceLocatorOptions options;
    options.masks = !picture.seen.empty();
    sequence_.emplace(locator_, camera_, options);
  }

  const LocateRun& run_;
  Locator& locator_;
  Camera camera_;
  std::optional<SequenceLocator> sequence_;
};

}  // namespace

void locate_sequence(const LocateRun& run, const std::vector<LocateFrame>& frames, LocateFrames& pictures,
                     const MapSystem& system, Locator& locator, LocatedJournal& journal,
                     const std::function<void(const ProgressState&)>& progress, LocateReport& report) {
  journal.clear();  // the motion before a stop is unknown
  ProgressState state{.unit = "frames", .bad = "without a pose"};
  state.total = static_cast<int>(frames.size());
  const internal::Stopwatch time;
  Chain chain(run, locator);
  for (const LocateFrame& frame : frames) {
    cv::Mat image;
    try {
      image = pictures.read(frame);
    } catch (const Error& e) {
      report.failed.push_back(frame.image + ": " + e.what());
      if (report.failed.size() == frames.size()) throw;
    }
    if (!image.empty()) journal.add(chain.add(frame, image), system);
    state.failed += image.empty() || !journal.frames().back().has_pose();
    state.done += 1, state.seconds = 1e-3 * time.ms();
    progress(state);
  }
  report.frames = journal.frames();
  const std::vector<SequencePose> poses = chain.all();
  for (size_t i = 0; i < poses.size(); ++i) {
    set_pose(poses[i], report.frames[i]);
    if (!poses[i].located.converged()) report.frames[i].footprint.clear();
  }
  journal.replace(report.frames, system);
}

}  // namespace iclk
