#pragma once
#include <memory>

#include <iclk/engine/context.h>

#include "apps/iclk/sets/scene.h"

namespace iclk {

/// Two views of procedural terrain (render/), a village and its fields from 120 m above, after a motion of 3 degrees and
/// 3.6 m; `options` say size, exposure and noise of the target, as for make_scene_pair(). Throws as TerrainRenderer does.
ScenePair render_scene_pair(const std::shared_ptr<const engine::Context>& context, const SceneOptions& options = {});

}  // namespace iclk
