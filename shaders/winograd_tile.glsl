// Which pixels a tile of N x N outputs covers: the sub-grid (phase) of a dilated convolution is the innermost but one index,
// so that neighbours in number are neighbours in memory. Needs N and the push constants WinogradPush.
struct Tile {
  int image, x, y;  // first output pixel; the others are `dilation` apart
};

Tile tile_at(int index) {
  int dilation = int(push.dilation), tiles_x = int(push.tiles_x);
  int row = index / tiles_x, tx = index - row * tiles_x;
  int line = row / dilation, phase_x = row - line * dilation;  // line: row of tiles of a vertical phase
  int lines = int(push.tiles_y) * dilation;
  int image = line / lines;
  line -= image * lines;
  int ty = line / dilation, phase_y = line - ty * dilation;
  return Tile(image, tx * N * dilation + phase_x, ty * N * dilation + phase_y);
}
