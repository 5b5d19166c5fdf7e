#include <iclk/align/device/impl.h>

namespace iclk {

void DeviceAligner::warm_up() {
  Impl& m = *impl_;
  m.check_nothing_started();
  m.submission.wait();  // as in set_reference()
  engine::Recorder recorder(m.submission, m.arena);
  recorder.compile_only();
  const internal::Stages s = m.stages();
  const internal::Stages::Run first{0, 1};
  s.maps(recorder, std::span(&first, 1), 1);
  s.prepare(recorder, first);
  if (m.solver == Solver::device) {
    s.align(recorder, 1);
  } else {
    s.match(recorder, 1);
    for (int level = m.options.levels - 1; level >= 0; --level) {
      s.weights(recorder, level, 1, ICLK_FLAG_GIVEN);
      s.normal_equations(recorder, level, 1, 0, ICLK_FLAG_GIVEN);
    }
    s.agreement(recorder, 1, ICLK_FLAG_GIVEN);
  }
  recorder.finish();
  m.submission.end();
  m.submission.submit_and_wait();
}

}  // namespace iclk
