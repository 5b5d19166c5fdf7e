// Level geometry and the warp; needs shared.h.
struct LevelCamera {
  float fx, fy, cx, cy;
  float last_u, last_v;  // width - 1, height - 1
};

// u_l = (u + 0.5) / 2^l - 0.5
LevelCamera level_camera(ReferenceInfo r, LevelInfo info, uint level) {
  float s = 1.0 / float(1u << level);
  return LevelCamera(r.fx * s, r.fy * s, (r.cx + 0.5) * s - 0.5, (r.cy + 0.5) * s - 0.5,
                     float(info.width) - 1.0, float(info.height) - 1.0);
}
