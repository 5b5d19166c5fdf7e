// The pixels of a tile of N x N outputs. A dilated convolution has dilation^2 interleaved sub-grids with separate tiles, in
// rows of tiles_x sites. Needs N, M and `push`.
//
// Odd dilation: the sub-grid (phase) is the second innermost index, so that tiles with adjacent numbers are adjacent in memory.
// Even dilation: four sub-grids form 2x2 blocks of adjacent pixels, and an invocation of the product has the tiles of all four
// at its site. Tiles of the first sub-grid for all lanes of a workgroup are therefore followed by those of the second.
struct Tile {
  int image, x, y;  // first output pixel; the others are `dilation` apart. The image may be one too many
};

Tile tile_at(int index) {
  int dilation = int(push.dilation), tiles_x = int(push.tiles_x), bits = int(push.lane_bits), even = 1 - dilation % 2;
  int site = even == 1 ? (index >> (bits + 2) << bits) + (index & ((1 << bits) - 1)) : index;
  int grid = even == 1 ? (index >> bits) & 3 : 0, phases = dilation >> even;
  int row = site / tiles_x, tx = site - row * tiles_x;
  int line = row / phases, phase_x = (row - line * phases << even) + grid % 2;  // line: row of tiles of a vertical phase
  int lines = int(push.tiles_y) * phases;
  int image = line / lines;
  line -= image * lines;
  int ty = line / phases, phase_y = (line - ty * phases << even) + grid / 2;
  return Tile(image, tx * N * dilation + phase_x, ty * N * dilation + phase_y);
}
