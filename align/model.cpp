#include <iclk/align/model.h>

namespace iclk {

size_t Model::parameters() const {
  size_t n = 0;
  const auto add = [&](const ConvLayer& layer) { n += layer.weight.size() + layer.bias.size(); };
  for (const auto& level : encoder)
    for (const ConvLayer& layer : level) add(layer);
  for (const ConvLayer& layer : m_estimator) add(layer);
  return n;
}

double Model::encoder_macs(int width, int height, int levels) const {
  double macs = 0;
  for (int l = 0; l < levels && l < this->levels(); ++l)
    for (const ConvLayer& layer : encoder[static_cast<size_t>(l)])
      macs += 9.0 * layer.in * layer.out * (width >> l) * (height >> l);
  return macs;
}

AlignerOptions Model::options() const {
  AlignerOptions options;
  options.levels = levels();
  options.iterations = iterations;
  options.lambda = damping;
  options.carry = carry;
  options.robust = Robust::unit;
  options.photometric = false;
  return options;
}

}  // namespace iclk
