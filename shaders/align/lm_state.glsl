// Loads and stores of the state between dispatches, and the trace. Needs lm_step.glsl, information.glsl and the
// bindings states[] and trace[].

#define STORE_POSE(to, T)                                                                                         \
  to[0] = T.R[0][0]; to[1] = T.R[1][0]; to[2] = T.R[2][0]; to[3] = T.t.x; to[4] = T.R[0][1]; to[5] = T.R[1][1];   \
  to[6] = T.R[2][1]; to[7] = T.t.y; to[8] = T.R[0][2]; to[9] = T.R[1][2]; to[10] = T.R[2][2]; to[11] = T.t.z;

Lm load_state(uint pair) {
  Lm lm;
  lm.pose = pose_of(states[pair].pose);
  lm.gain = states[pair].gain;
  lm.bias = states[pair].bias;
  lm.accepted_pose = pose_of(states[pair].accepted_pose);
  lm.accepted_gain = states[pair].accepted_gain;
  lm.accepted_bias = states[pair].accepted_bias;
  lm.objective = states[pair].objective;
  lm.predicted = states[pair].predicted;
  lm.lambda = states[pair].lambda;
  lm.nu = states[pair].nu;
  lm.last_step = states[pair].last_step;
  lm.scale = states[pair].belief_scale;
  lm.has_accepted = states[pair].has_accepted != 0u;
  lm.done = states[pair].done != 0u;
  lm.singular = states[pair].singular != 0u;
#define LOAD_SUM(n)                                                                                \
  accepted_sums[n] = vec4(states[pair].sums[4 * n], states[pair].sums[4 * n + 1],                  \
                          states[pair].sums[4 * n + 2], states[pair].sums[4 * n + 3]);
  LOAD_SUM(0) LOAD_SUM(1) LOAD_SUM(2) LOAD_SUM(3) LOAD_SUM(4) LOAD_SUM(5) LOAD_SUM(6) LOAD_SUM(7)
  LOAD_SUM(8) LOAD_SUM(9) LOAD_SUM(10) LOAD_SUM(11) LOAD_SUM(12) LOAD_SUM(13) LOAD_SUM(14)
  return lm;
}

void store_state(uint pair, Lm lm) {
  STORE_POSE(states[pair].pose, lm.pose)
  states[pair].gain = lm.gain;
  states[pair].bias = lm.bias;
  STORE_POSE(states[pair].accepted_pose, lm.accepted_pose)
  states[pair].accepted_gain = lm.accepted_gain;
  states[pair].accepted_bias = lm.accepted_bias;
  states[pair].objective = lm.objective;
  states[pair].predicted = lm.predicted;
  states[pair].lambda = lm.lambda;
  states[pair].nu = lm.nu;
  states[pair].last_step = lm.last_step;
  states[pair].belief_scale = lm.scale;
  states[pair].has_accepted = lm.has_accepted ? 1u : 0u;
  states[pair].done = lm.done ? 1u : 0u;
  states[pair].singular = lm.singular ? 1u : 0u;
#define STORE_SUM(n)                                                                                            \
  states[pair].sums[4 * n] = accepted_sums[n].x; states[pair].sums[4 * n + 1] = accepted_sums[n].y;             \
  states[pair].sums[4 * n + 2] = accepted_sums[n].z; states[pair].sums[4 * n + 3] = accepted_sums[n].w;
  STORE_SUM(0) STORE_SUM(1) STORE_SUM(2) STORE_SUM(3) STORE_SUM(4) STORE_SUM(5) STORE_SUM(6) STORE_SUM(7)
  STORE_SUM(8) STORE_SUM(9) STORE_SUM(10) STORE_SUM(11) STORE_SUM(12) STORE_SUM(13) STORE_SUM(14)
}

// Resets damping and the accepted point at the start of a level; the pose is kept.
void begin_level(inout Lm lm) {
  lm.lambda = push.lambda;
  lm.nu = 2.0;
  lm.predicted = 0.0;
  lm.last_step = 0.0;
  lm.has_accepted = false;
  lm.done = false;
  lm.singular = false;
}

// Judges the evaluation in `sums`, takes a step and writes the trace. `first` = iteration number within the level.
void lm_advance(inout Lm lm, uint pair, uint iteration, bool believes, float focal, float mean_inverse_depth, bool write) {
  float cost = sums[11].w > 0.0 ? sums[14].x / sums[11].w : 0.0;
  float visible = sums[14].z > 0.0 ? sums[14].y / sums[14].z : 0.0;
  bool accepted = lm_judge(lm, pair, believes);
  float lambda = lm.lambda;
  lm_propose(lm, pair, believes, focal, mean_inverse_depth, push.step_tolerance);
  if (!write) return;
  uint at = pair * push.trace_stride + push.trace_offset + iteration;
  STORE_POSE(trace[at].pose, lm.pose)
  trace[at].cost = cost;
  trace[at].visible = visible;
  trace[at].step = lm.last_step;
  trace[at].lambda = lambda;
  trace[at].accepted = accepted ? 1u : 0u;
}

void lm_end(inout Lm lm, uint pair, bool believes) {
  lm_judge(lm, pair, believes);
  lm.pose = lm.accepted_pose;
  lm.gain = lm.accepted_gain;
  lm.bias = lm.accepted_bias;
}

// Writes the belief for the next finer level, after store_state(). One invocation.
void leave_belief(uint pair, Lm lm, bool believes) {
  if (push.carry == 0.0) return;
  uint to = push.level & 1u;
  if (skips_level(pair)) {  // the belief is unchanged
    uint from = to ^ 1u;
    bool prior = pairs[pair].has_prior != 0u;
    STORE_POSE(states[pair].beliefs[to].pose, lm.pose)
    for (uint i = 0u; i < 12u && (carried() || prior); ++i)
      states[pair].beliefs[to].pose[i] = carried() ? states[pair].beliefs[from].pose[i] : pairs[pair].prior_pose[i];
    for (uint i = 0u; i < 36u; ++i)
      states[pair].beliefs[to].information[i] = carried() ? states[pair].beliefs[from].information[i]
                                                : prior   ? pairs[pair].prior_information[i] : 0.0;
    return;
  }
  float information[36], size = 0.0, own;
  for (uint i = 0u; i < 36u; ++i) {
    information[i] = push.carry * pose_information(pair, PHOTOMETRIC, i / 6u, i % 6u, own) / lm.scale;
    size += abs(information[i]);
  }
  bool finite = is_finite(size) && size < 1e30;  // a level without a result must not spoil the next
  for (uint i = 0u; i < 36u; ++i) information[i] = finite ? information[i] : 0.0;
  if (believes) {
    Prior p = belief_at(pair, lm.pose);
    for (uint i = 0u; i < 36u; ++i) information[i] += p.H[i];
  }
  for (uint i = 0u; i < 36u; ++i) states[pair].beliefs[to].information[i] = information[i];
  STORE_POSE(states[pair].beliefs[to].pose, lm.pose)
}
