// Projects planes of the reference into the views; needs `Views` as `views` and `push`.
vec3 ray_in(uint view, vec2 uv) {
  precise vec3 h;
  h.x = views.view[view].row_u.x * uv.x + views.view[view].row_u.y * uv.y + views.view[view].row_u.z;
  h.y = views.view[view].row_v.x * uv.x + views.view[view].row_v.y * uv.y + views.view[view].row_v.z;
  h.z = views.view[view].row_z.x * uv.x + views.view[view].row_z.y * uv.y + views.view[view].row_z.z;
  return h;
}

vec3 epipole_of(uint view) { return vec3(views.view[view].row_u.w, views.view[view].row_v.w, views.view[view].row_z.w); }

// The change of h per pixel to the right, and per pixel down.
vec3 ray_right(uint view) { return vec3(views.view[view].row_u.x, views.view[view].row_v.x, views.view[view].row_z.x); }
vec3 ray_down(uint view) { return vec3(views.view[view].row_u.y, views.view[view].row_v.y, views.view[view].row_z.y); }

// The numbers of the nearest pixels in the view; 0 if not `inside` (outside or behind).
ivec4 pixels_in(vec3 h, vec3 e, vec4 w, out bvec4 inside) {
  precise vec4 x = h.x + e.x * w, y = h.y + e.y * w, z = h.z + e.z * w;
  precise vec4 u = x / z + 0.5, v = y / z + 0.5;
  float width = float(push.width), height = float(push.height);
  uvec4 seen = uvec4(greaterThan(z, vec4(0))) & uvec4(greaterThanEqual(u, vec4(0))) & uvec4(greaterThanEqual(v, vec4(0))) &
               uvec4(lessThan(u, vec4(width))) & uvec4(lessThan(v, vec4(height)));
  inside = bvec4(seen);
  return mix(ivec4(0), ivec4(v) * int(push.width) + ivec4(u), inside);
}

// The same for one plane; -1 if not inside.
int pixel_in(vec3 h, vec3 e, float w) {
  bvec4 inside;
  int pixel = pixels_in(h, e, vec4(w), inside).x;
  return inside.x ? pixel : -1;
}
