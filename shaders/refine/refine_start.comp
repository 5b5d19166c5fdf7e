#version 460
// Makes the first tasks of feature alignment, at the poses of ICLK.
// Inputs: pairs, ICLK's results. Outputs: tasks, states, turns of zero, and ICLK's results as refined ones.
// Groups: (ceil(pairs / 64), 1, 1).
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
#include "refine/refine.h"
layout(local_size_x = ICLK_REFINE_GROUP) in;
layout(set = 0, binding = 0, std430) readonly buffer Pairs { RefinePair pairs[]; };
layout(set = 0, binding = 1, std430) readonly buffer Results { ResultInfo results[]; };
layout(set = 0, binding = 2, std430) writeonly buffer Tasks { FeatureTask tasks[]; };
layout(set = 0, binding = 3, std430) writeonly buffer States { RefineState states[]; };
layout(set = 0, binding = 4, std430) writeonly buffer Turns { TurnInfo turns[]; };
layout(set = 0, binding = 5, std430) writeonly buffer Refined { RefinedInfo refined[]; };
layout(push_constant) uniform Push { RefinePush push; };

void main() {
  uint index = gl_GlobalInvocationID.x;
  if (index >= push.pairs) return;
  RefinePair pair = pairs[index];
  bool usable = results[index].status <= 1u;  // converged or max_iterations
  tasks[index] = FeatureTask(pair.reference, pair.pair, pair.first_feature, usable ? pair.feature_count : 0u, 0u,
                             results[index].pose);
  states[index].pose = results[index].pose;
  states[index].floor = states[index].depth_sigma = states[index].cost = 0.0;
  states[index].used = states[index].inliers = states[index].rounds = 0u;
  states[index].status = results[index].status;
  turns[index].turn = float[3](0.0, 0.0, 0.0);
  for (int i = 0; i < 36; ++i) turns[index].doubt[i] = 0.0;
  refined[index].pose = results[index].pose;
  refined[index].covariance = results[index].covariance;
  refined[index].status = results[index].status;
}
