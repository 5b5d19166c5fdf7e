// The data of a pair for the shaders of the iterations. Needs shared.h, se3.glsl, level.glsl, residual.glsl and the bindings
//   levels[], references[], pairs[], states[]  and the push constants IteratePush.

View view_of(uint pair) {
  uint reference = pairs[pair].reference;
  LevelInfo info = levels[push.level];
  View view;
  view.camera = level_camera(references[reference], info, push.level);
  view.template_base = int(reference * push.element_stride + info.element_offset);
  view.map_base = int(pairs[pair].target * push.map_stride + info.map_offset);
  view.pitch = int(info.pitch);
  view.weight_base = pair * (push.weight_stride / 4u);
  view.unit_weights = !WEIGHTED || (push.flags & ICLK_FLAG_UNIT_WEIGHTS) != 0u;
  return view;
}

// Sets the point to evaluate: that of the host, or that of the state.
void set_point(inout View view, uint pair) {
  if ((push.flags & ICLK_FLAG_GIVEN) != 0u) {
    view.pose = pose_of(pairs[pair].pose);
    view.gain = pairs[pair].gain;
    view.bias = pairs[pair].bias;
  } else {
    view.pose = pose_of(states[pair].pose);
    view.gain = states[pair].gain;
    view.bias = states[pair].bias;
  }
}
