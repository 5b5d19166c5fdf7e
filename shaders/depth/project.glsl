// Where planes of the reference lie in the views; needs `Views` as `views` and `push`.
vec3 ray_in(uint view, vec2 uv) {
  precise vec3 h;
  h.x = views.view[view].row_u.x * uv.x + views.view[view].row_u.y * uv.y + views.view[view].row_u.z;
  h.y = views.view[view].row_v.x * uv.x + views.view[view].row_v.y * uv.y + views.view[view].row_v.z;
  h.z = views.view[view].row_z.x * uv.x + views.view[view].row_z.y * uv.y + views.view[view].row_z.z;
  return h;
}

vec3 epipole_of(uint view) { return vec3(views.view[view].row_u.w, views.view[view].row_v.w, views.view[view].row_z.w); }

// The pixel's number in the view, nearest; -1 outside and behind.
int pixel_in(vec3 h, vec3 e, float w) {
  precise vec3 x = h + e * w;
  if (!(x.z > 0.0)) return -1;
  precise vec2 uv = x.xy / x.z + 0.5;
  if (!(uv.x >= 0.0 && uv.y >= 0.0 && uv.x < float(push.width) && uv.y < float(push.height))) return -1;
  return int(uv.y) * int(push.width) + int(uv.x);
}
