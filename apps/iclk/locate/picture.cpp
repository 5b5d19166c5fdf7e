#include "apps/iclk/locate/picture.h"

#include "apps/iclk/io/images.h"
#include "apps/iclk/io/levels.h"
#include "apps/iclk/io/undistorter.h"

namespace iclk {

LocatePicture::LocatePicture(const LocateRun& run, const cv::Mat& taken)
    : camera(fit_camera(*run.camera, taken.cols, taken.rows)), image(taken) {
  Levels{taken}.apply(image);
  if (run.lens().empty()) return;
  const Undistorter lens(camera, run.lens());
  image = lens.image(image), seen = lens.seen();
}

std::string draw_located(const LocatePicture& picture, Locator& locator, LocatedFrame& frame) {
  const View map = locator.view(picture.camera, frame.located.T_WC);
  frame.footprint = footprint_of(map, picture.camera, frame.located.T_WC);
  return encode_png(located_overlay(map, picture.image, picture.camera));
}

}  // namespace iclk
