// Triangles, sixteen to a block.
//
// The test moves the ray's origin to 0 and shears space so that the ray runs along an axis; the
// triangle is hit if 0 lies within its projection, which the signs of three edge functions tell. A
// vertex is projected without regard to the triangle that asks, and an edge function changes only
// its sign when its ends are exchanged, so neighbours never disagree on the side of their edge that
// the ray passes: a closed mesh has no gap, not at edges and not at vertices.
// Method: Woop, Benthin and Wald, "Watertight Ray/Triangle Intersection", JCGT 2(1), 2013.
//
// In float the sign of an edge function is right or it is 0, since rounding keeps the order of its
// two products. So float tells which of sixteen triangles a ray passes through, or which of sixteen
// rays pass through a triangle; where a function is 0 double decides, in which the products are
// exact. Float also leaves out those whose vertices all lie behind the ray or beyond its limit. The
// distance of the others, of which the nearest counts, is taken in double: the weights of a needle
// would mean nothing in float. None is needed behind a plane that the ray leaves, nor for a shadow
// ray where all vertices lie between.
#pragma once
#include "point.h"

namespace parhelion {

// Vertices by number, axis and lane; NaN in unused lanes, which no comparison accepts. id is the
// primitive's place in the user's arrays.
struct alignas(64) TriangleBlock {
  float vertex[3][3][16];
  u32 id[16];
};

}  // namespace parhelion

namespace parhelion::PH_ISA {

// Counter-clockwise seen from the front, where the normal points.
struct Triangle {
  Vec3 vertex[3];
};

PH_INLINE Triangle primitive(const TriangleBlock& block, u32 lane) {
  Triangle t;
  for (int k = 0; k < 3; ++k) {
    const auto& v = block.vertex[k];
    t.vertex[k] = {v[0][lane], v[1][lane], v[2][lane]};
  }
  return t;
}

// Along the normal, twice the area long; 0 if the vertices lie on a line.
PH_INLINE DVec3 doubled_area(const Triangle& t) {
  return cross(difference(t.vertex[1], t.vertex[0]), difference(t.vertex[2], t.vertex[0]));
}

PH_INLINE float area(const Triangle& t) {
  return static_cast<float>(0.5 * length(doubled_area(t)));
}

// A projected vertex is wrong by the rounding of 2 differences and 5 more operations with numbers
// up to 4: by 28 kRounding along each of two axes, which kBoxPad exceeds.
PH_INLINE Box bounds(const Triangle& t) {
  return padded(min(t.vertex[0], min(t.vertex[1], t.vertex[2])),
                max(t.vertex[0], max(t.vertex[1], t.vertex[2])));
}

// What the test wants to know of a ray: the axis z along which it runs fastest, the two others, its
// steps along them for one along z, and the length of ray for that one.
struct Shear {
  int x, y, z;
  float step_x, step_y, inverse;
};

PH_INLINE Shear shear_along(Vec3 direction) {
  const int z = fastest_axis(direction), x = next_axis(z), y = next_axis(x);
  const float inverse = 1.0f / component(direction, z);
  return {x, y, z, component(direction, x) * inverse, component(direction, y) * inverse, inverse};
}

// Edge functions, which are the vertices' weights times `sum`: of one sign, not all 0, where the
// ray's line passes through.
struct Weights {
  double a, b, c, sum;
};

PH_INLINE bool pierced(const Triangle& t, const Ray& ray, const Shear& shear, Weights& w) {
  double x[3], y[3];
  for (int k = 0; k < 3; ++k) {
    const Vec3 v = t.vertex[k] - ray.origin;
    const float z = component(v, shear.z);
    x[k] = component(v, shear.x) - shear.step_x * z;  // rounded to float as in the lanes
    y[k] = component(v, shear.y) - shear.step_y * z;
  }
  w.a = x[2] * y[1] - y[2] * x[1];
  w.b = x[0] * y[2] - y[0] * x[2];
  w.c = x[1] * y[0] - y[1] * x[0];
  w.sum = w.a + w.b + w.c;
  const bool below = (w.a <= 0.0) & (w.b <= 0.0) & (w.c <= 0.0);  // without branches
  const bool above = (w.a >= 0.0) & (w.b >= 0.0) & (w.c >= 0.0);
  return (below | above) & (w.sum != 0.0);
}

// How far below a triangle's plane a ray starts, and how fast it rises, both times the length of
// doubled_area.
struct Climb {
  double height, slope;
};

PH_INLINE Climb climb_to(const Triangle& t, Vec3 origin, Vec3 direction) {
  const DVec3 n = doubled_area(t);
  return {dot(n, difference(t.vertex[0], origin)), dot(n, to_double(direction))};
}

// Distance at which a ray passes through a triangle that is no mere line. Of the ray, and of the
// triangle's vertices, what lies along the ray's fastest axis. Without branches all is worked out.
template <bool kBranches = true>
PH_INLINE float distance_to(const Climb& climb, float origin, float direction, Vec3 vertices) {
  // By the plane: the weights' rounding would make a distance of the 0 at which a ray that starts
  // on a neighbour's edge meets this one. Of rays along the plane, between the vertices'.
  double at = climb.height / climb.slope;
  const double start = origin, step = direction;
  const double low = min(vertices.x, min(vertices.y, vertices.z));
  const double high = max(vertices.x, max(vertices.y, vertices.z));
  const double z = start + at * step;
  if (!kBranches || z < low || z > high) {
    const double between = (clamp(z, low, high) - start) / step;
    const bool outside = (z < low) | (z > high);
    at = outside ? between : at;
  }
  return static_cast<float>(at);
}

// What float tells of sixteen rays and triangles, a bit for each.
struct Passed {
  u32 may;     // the ray may pass through at a distance in (0, limit]
  u32 does;    // of all: it passes through, at whatever distance
  u32 ahead;   // of all: all vertices are, so if it does, it is at a distance above 0
  u32 within;  // of all: if it does, it is at a distance in (0, limit]
};

// Of each the ray's origin, the shear's steps and inverse, and the limit; vertex(k, axis) is
// coordinate x, y or z (0, 1, 2) of vertex k. All of them are by the shear's axes.
template <class Vertex>
PH_INLINE Passed pass(Vertex&& vertex, const Lanes& origin_x, const Lanes& origin_y,
                      const Lanes& origin_z, const Lanes& step_x, const Lanes& step_y,
                      const Lanes& inverse, const Lanes& limit) {
  Lanes x[3], y[3], z[3];
  for (int k = 0; k < 3; ++k) {
    z[k] = vertex(k, 2) - origin_z;
    x[k] = (vertex(k, 0) - origin_x) - step_x * z[k];
    y[k] = (vertex(k, 1) - origin_y) - step_y * z[k];
  }
  const Lanes a = x[2] * y[1] - y[2] * x[1];
  const Lanes b = x[0] * y[2] - y[0] * x[2];
  const Lanes c = x[1] * y[0] - y[1] * x[0];
  const Lanes least = min(a, min(b, c)), most = max(a, max(b, c)), zero = all(0.0f);
  const u32 may = bits((zero <= least) | (most <= zero));
  if (may == 0) return {0, 0, 0, 0};
  // The distance lies between those of the vertices along z, each of them rounded three times.
  for (Lanes& along : z) along = along * inverse;
  const Lanes nearest = min(z[0], min(z[1], z[2])), farthest = max(z[0], max(z[1], z[2]));
  constexpr float kSlack = 0x1p-21f;
  const u32 ahead = bits(zero < nearest);
  return {may & bits((zero < farthest) & (nearest <= limit * all(1.0f + kSlack))),
          bits((zero < least) | (most < zero)), ahead,
          ahead & bits(farthest <= limit * all(1.0f - kSlack))};
}

// A block's triangles and one ray.
PH_INLINE Passed pass(const TriangleBlock& block, const Ray& ray, const Shear& shear, float limit) {
  const int axis[3] = {shear.x, shear.y, shear.z};
  return pass([&](int k, int i) { return load(block.vertex[k][axis[i]]); },
              all(component(ray.origin, shear.x)), all(component(ray.origin, shear.y)),
              all(component(ray.origin, shear.z)), all(shear.step_x), all(shear.step_y),
              all(shear.inverse), all(limit));
}

// Whether the ray does meet a triangle that it may meet, and at what distance.
PH_INLINE bool met(const TriangleBlock& block, u32 lane, const Passed& passed, const Ray& ray,
                   const Shear& shear, float limit, float& distance) {
  const Triangle t = primitive(block, lane);
  Weights w;
  if ((passed.does >> lane & 1u) == 0 && !pierced(t, ray, shear, w)) return false;
  const Climb climb = climb_to(t, ray.origin, ray.direction);
  // What lies behind, such as what rays start close to, is told without a division. Where a vertex
  // is not ahead, neither is what distance_to would put between the vertices.
  if ((passed.ahead >> lane & 1u) == 0 && climb.height * climb.slope < 0.0) return false;
  const auto along = [&](int k) { return block.vertex[k][shear.z][lane]; };
  distance = distance_to(climb, component(ray.origin, shear.z), component(ray.direction, shear.z),
                         {along(0), along(1), along(2)});
  return distance > 0.0f && distance <= limit;
}

// found(lane, t) for each of the block's triangles that is hit at 0 < t <= limit. self_lane: the
// lane that the ray starts on, which is never hit, or kNone. The direction may have any length.
template <class Found>
PH_INLINE void intersect(const TriangleBlock& block, const Ray& ray, float limit, u32 self_lane,
                         Found&& found) {
  const Shear shear = shear_along(ray.direction);
  const Passed passed = pass(block, ray, shear, limit);
  u32 may = passed.may;
  if (self_lane != kNone) may &= ~(1u << self_lane);
  for (; may != 0; may &= may - 1) {
    const u32 lane = lowest_bit(may);
    float t;
    if (met(block, lane, passed, ray, shear, limit, t)) found(lane, t);
  }
}

// A bit for each of the block's triangles that some ray of a bundle may hit before `limit`. Sheared
// so that its middle runs along an axis, the bundle is a rectangle around 0, and misses triangles
// of which it lies beyond one edge and not beyond another.
PH_INLINE u32 intersect_bundle(const TriangleBlock& block, const Bundle& rays, float limit) {
  const u32 there = bits(load(block.vertex[0][0]) <= all(kInfinity));  // not NaN
  if (!(rays.spread < 0.0625f)) return there;
  const Shear shear = shear_along(rays.direction);
  const Lanes origin_x = all(component(rays.origin, shear.x));
  const Lanes origin_y = all(component(rays.origin, shear.y));
  const Lanes origin_z = all(component(rays.origin, shear.z));
  Lanes x[3], y[3], along[3];
  for (int k = 0; k < 3; ++k) {
    const Lanes z = load(block.vertex[k][shear.z]) - origin_z;
    x[k] = (load(block.vertex[k][shear.x]) - origin_x) - all(shear.step_x) * z;
    y[k] = (load(block.vertex[k][shear.y]) - origin_y) - all(shear.step_y) * z;
    along[k] = z * all(shear.inverse);
  }
  const Lanes nearest = min(along[0], min(along[1], along[2]));
  const Lanes farthest = max(along[0], max(along[1], along[2]));
  // A ray's distance to where it passes a triangle that it hits is that along the middle, but for
  // less than five radii and four spreads of the distance. There it is off the middle by no more
  // than this. Of a triangle that reaches behind the origin and is seen from its edge, its line may
  // pass it behind. kBoxPad exceeds what rounding moves the test's vertices, and those here.
  const float wider = 1.0f + 4.0f * rays.spread, longer = 5.0f * rays.radius;
  const Lanes way = farthest * all(wider) + all(longer);
  const Lanes reach = max(farthest, all(0.0f) - nearest) * all(wider) + all(longer);
  const auto off = [&](int axis, float step) {
    const auto sheared = [&](Vec3 a) {
      return component(a, axis) + abs(step) * component(a, shear.z);
    };
    return reach * all(sheared(rays.direction_off)) +
           all(sheared(rays.origin_off) + 4.0f * kBoxPad);
  };
  const Lanes off_x = off(shear.x, shear.step_x), off_y = off(shear.y, shear.step_y);
  const auto size = [](const Lanes& a) { return max(a, all(0.0f) - a); };
  u32 above = 0, below = 0;
  for (u32 k = 0; k < 3; ++k) {
    const u32 next = k == 2 ? 0 : k + 1;
    const Lanes one = x[k] * y[next], other = y[k] * x[next], side = one - other;
    const Lanes room = size(x[next] - x[k]) * off_y + size(y[next] - y[k]) * off_x +
                       (size(one) + size(other)) * all(4.0f * kRounding);  // that of `side`, too
    above |= bits(room < side);
    below |= bits(side + room < all(0.0f));
  }
  const Lanes least = nearest - way * all(4.0f * rays.spread) - all(longer);
  return there & bits(least <= all(limit)) & bits(all(0.0f) <= way) & ~(above & below);
}

// The distances at which sixteen rays, none of which starts on a triangle, meet it; of those that
// do not before their limits, 0 or what lies beyond. False only if none does. along: the axis along
// which all run fastest.
PH_INLINE bool intersect_rays(const Triangle& t, const Rows<Vec3, kLanes>& origin,
                              const Rows<Vec3, kLanes>& direction, int along,
                              const float (&limit)[kLanes], float (&distance)[kLanes]) {
  const int x = next_axis(along), y = next_axis(x);
  const int axis[3] = {x, y, along};
  const Lanes inverse = all(1.0f) / load(direction.row[along]);
  const Passed passed =
      pass([&](int k, int i) { return all(component(t.vertex[k], axis[i])); }, load(origin.row[x]),
           load(origin.row[y]), load(origin.row[along]), load(direction.row[x]) * inverse,
           load(direction.row[y]) * inverse, inverse, load(limit));
  u32 hits = passed.may & passed.does;
  for_each_bit(passed.may & ~passed.does, [&](u32 k) {
    const Ray ray = {origin.at(k), direction.at(k), kNoSlot, false};
    Weights w;
    hits |= (pierced(t, ray, shear_along(ray.direction), w) ? 1u : 0u) << k;
  });
  if (hits == 0) return false;
  const Vec3 vertices = {component(t.vertex[0], along), component(t.vertex[1], along),
                         component(t.vertex[2], along)};
  for (u32 k = 0; k < kLanes; ++k) {
    const Climb climb = climb_to(t, origin.at(k), direction.at(k));
    const float at =
        distance_to<false>(climb, origin.row[along][k], direction.row[along][k], vertices);
    distance[k] = (hits >> k & 1u) != 0 ? at : 0.0f;
  }
  return true;
}

// Whether any is hit but those of `ignored`, a bit for each.
PH_INLINE bool intersect_any(const TriangleBlock& block, const Ray& ray, float limit, u32 ignored) {
  const Shear shear = shear_along(ray.direction);
  const Passed passed = pass(block, ray, shear, limit);
  u32 may = passed.may & ~ignored;
  if ((may & passed.does & passed.within) != 0) return true;
  for (; may != 0; may &= may - 1) {
    float distance;
    if (met(block, lowest_bit(may), passed, ray, shear, limit, distance)) return true;
  }
  return false;
}

// Where a ray that hits meets the surface.
PH_INLINE void surface(const Triangle& t, const Ray& ray, float, SurfacePoint& out) {
  Weights w;
  pierced(t, ray, shear_along(ray.direction), w);
  const double b = w.b / w.sum, c = w.c / w.sum;
  place(t.vertex[0],
        difference(t.vertex[1], t.vertex[0]) * b + difference(t.vertex[2], t.vertex[0]) * c,
        doubled_area(t), out);
  out.parameter = {static_cast<float>(b), static_cast<float>(c)};
}

// --- Directions towards a triangle --------------------------------------------------------------
//
// Uniform in solid angle where that is large enough to matter, else uniform in area: below, a float
// direction tells too few points of the triangle apart, and the two densities are nearly the same.
inline constexpr float kLeastSolidAngle = 1e-4f;

// The triangle seen from a point: unit vectors p, q, r to its vertices, and the terms of
// tan(solid angle / 2) = triple / (sides + base).
// Method: A. van Oosterom and J. Strackee, "The Solid Angle of a Plane Triangle", IEEE Transactions
// on Biomedical Engineering 30(2), 1983. The triple product of a small triangle's directions is a
// small difference; taken from the plane's height, which is double, it is not.
struct SphericalTriangle {
  Vec3 p, q, r;
  float triple;  // |p . (q x r)|
  float sides;   // p.r + q.r
  float base;    // 1 + p.q
  float solid_angle;
};

// height: how far `from` lies below the plane, times the length of doubled_area(t).
PH_INLINE SphericalTriangle seen_from(const Triangle& t, Vec3 from, double height) {
  SphericalTriangle s;
  s.p = to_float(difference(t.vertex[0], from));
  s.q = to_float(difference(t.vertex[1], from));
  s.r = to_float(difference(t.vertex[2], from));
  const float p = 1.0f / length(s.p), q = 1.0f / length(s.q), r = 1.0f / length(s.r);
  s.p *= p;
  s.q *= q;
  s.r *= r;
  s.triple = abs(static_cast<float>(height)) * p * q * r;
  s.sides = dot(s.p, s.r) + dot(s.q, s.r);
  s.base = 1.0f + dot(s.p, s.q);
  s.solid_angle = 2.0f * atan2(s.triple, s.sides + s.base);
  return s;
}

// Within the spherical triangle, equally likely everywhere. u.x picks the great circle from q that
// leaves that share of the area on p's side, u.y the place on it: J. Arvo, "Stratified Sampling of
// Spherical Triangles", SIGGRAPH 1995. That circle meets the side p r in w. The formula above, for
// p, q, w, is linear in the vector half way from p to w; solved for it, w needs neither angles nor
// cases: C. Peters, "BRDF Importance Sampling for Polygonal Lights", ACM TOG 40(4), 2021, section
// on triangles.
PH_INLINE Vec3 direction_within(const SphericalTriangle& s, Vec2 u) {
  const CosSin half = cos_sin_turns(u.x * s.solid_angle * (0.25f / kPi));
  const Vec3 middle = s.p * (s.triple * half.c - s.sides * half.s) + s.r * (s.base * half.s);
  const Vec3 w = middle * (2.0f * dot(s.p, middle) / dot(middle, middle)) - s.p;
  // Of the cosine of the angle from q, 1 - cosine is uniform.
  const float whole = dot(s.q, w);
  const float cosine = 1.0f - (1.0f - whole) * u.y;
  const float part = sqrt(u.y * (1.0f + cosine) / (1.0f + whole));
  return normalize(s.q * (cosine - part * whole) + w * part);
}

PH_INLINE float pdf_towards(const Triangle& t, Vec3 from, Vec3 direction, float distance,
                            Vec3 normal) {
  const double height = dot(doubled_area(t), difference(t.vertex[0], from));
  const float solid_angle = seen_from(t, from, height).solid_angle;
  if (solid_angle > kLeastSolidAngle) return 1.0f / solid_angle;
  return pdf_by_area(area(t), direction, distance, normal);
}

// Both ways are gone, without a branch, so that a loop over many triangles becomes one of vectors.
PH_INLINE TowardsSample sample_towards(const Triangle& t, Vec3 from, Vec2 u) {
  const DVec3 n = doubled_area(t);
  const double n2 = dot(n, n);
  const DVec3 to_first = difference(t.vertex[0], from);
  const double height = dot(n, to_first);
  const DVec3 e1 = difference(t.vertex[1], t.vertex[0]);
  const DVec3 e2 = difference(t.vertex[2], t.vertex[0]);
  SphericalTriangle seen = seen_from(t, from, height);
  const bool wide = seen.solid_angle > kLeastSolidAngle;
  seen.solid_angle = wide ? seen.solid_angle : 0.0f;  // which may be NaN
  const DVec3 d = to_double(direction_within(seen, u));
  const DVec3 along = d * (height / dot(n, d));
  const DVec3 q = along - to_first;
  const double b_wide = clamp(dot(n, cross(q, e2)) / n2, 0.0, 1.0);
  const double c_wide = clamp(dot(n, cross(e1, q)) / n2, 0.0, 1.0 - b_wide);
  const float root = sqrt(u.x);
  const double c_even = root * u.y, b_even = root - c_even;
  const DVec3 even = to_first + e1 * b_even + e2 * c_even;
  const DVec3 way = {wide ? along.x : even.x, wide ? along.y : even.y, wide ? along.z : even.z};
  TowardsSample s = towards(
      way, to_float(n * (1.0 / compiler::sqrt(n2))),
      {static_cast<float>(wide ? b_wide : b_even), static_cast<float>(wide ? c_wide : c_even)});
  const float by_area = pdf_by_area(area(t), s.direction, s.distance, s.normal);
  s.pdf = wide ? 1.0f / seen.solid_angle : by_area;
  // None of a line, or of what is seen edge-on.
  const bool seen_flat = !(n2 > 0.0) || height == 0.0;
  s.pdf = seen_flat ? kInfinity : s.pdf;
  return checked(s);
}

}  // namespace parhelion::PH_ISA
