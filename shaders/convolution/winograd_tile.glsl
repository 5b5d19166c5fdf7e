// Which pixels a tile of N x N outputs covers. A dilated convolution has dilation^2 interleaved sub-grids with tiles of their
// own, sites in rows of tiles_x. Needs N, M and `push`.
//
// An odd dilation: the sub-grid (phase) is the innermost but one index, so that neighbours in number are neighbours in memory.
// An even one: four sub-grids make 2x2 blocks of neighbouring pixels, and an invocation of the product has the tiles of all
// four at its site; so tiles of the first for all lanes of a workgroup are followed by those of the second.
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
