// A level's map: means over the channels of the requested pixels. Needs the push constants FeatureMapPush.
layout(set = 0, binding = 1, std430) writeonly buffer Maps { float maps[]; };

// 2x2 pixels of the map.
struct Block {
  uint map, pitch;  // of the first one
  uvec2 at, first, end;
  float inverse_channels;
};

// Reads the push constants, which is slow on lavapipe after divergent branches.
Block block_at(uint x, uint y, uint image) {
  uint pitch = push.map_pitch;
  return Block((push.first_image + image) * push.map_stride + push.map_offset + 2u * y * pitch + 2u * x, pitch,
               2u * uvec2(x, y), uvec2(push.first_u, push.first_v), uvec2(push.end_u, push.end_v), push.inverse_channels);
}

// Sums over the channels, row by row.
void write_block(Block block, vec4 sums) {
  [[unroll]] for (uint k = 0u; k < 4u; ++k) {
    uvec2 at = block.at + uvec2(k % 2u, k / 2u);
    if (all(greaterThanEqual(at, block.first)) && all(lessThan(at, block.end)))
      maps[block.map + (k / 2u) * block.pitch + k % 2u] = sums[k] * block.inverse_channels;
  }
}
