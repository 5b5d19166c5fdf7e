// The belief of a pair's pose apart from the images of this level: the prior of the host, and the information of coarser levels
// (align/solver/lm.h). Needs prior.glsl, the bindings pairs[] and states[] and the push constants IteratePush.

// A pair that begins at a finer level takes no step here, and its belief does not change.
bool skips_level(uint pair) { return push.level > pairs[pair].first_level; }

bool carried() { return (push.flags & ICLK_FLAG_CARRIED) != 0u; }
bool has_belief(uint pair) { return carried() || pairs[pair].has_prior != 0u; }

Prior belief_at(uint pair, Pose pose) {
  Pose mean;
  float information[36];
  if (carried()) {
    uint from = (push.level + 1u) & 1u;
    mean = pose_of(states[pair].beliefs[from].pose);
    for (int i = 0; i < 36; ++i) information[i] = states[pair].beliefs[from].information[i];
  } else {
    mean = pose_of(pairs[pair].prior_pose);
    for (int i = 0; i < 36; ++i) information[i] = pairs[pair].prior_information[i];
  }
  return prior_of(mean, information, pose);
}

// The factor of beliefs relative to the sums: the variance of the residuals in units of residual_sigma^2.
float belief_scale(float cost, float weight) {
  if (push.inverse_variance == 0.0) return 1.0;
  return max(weight > 0.0 ? cost / weight : 0.0, float(ICLK_LEAST_SIGMA * ICLK_LEAST_SIGMA)) * push.inverse_variance;
}
