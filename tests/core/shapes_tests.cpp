// The shapes' kernels against answers by other means: long double, sums over directions, and the
// topology of a closed mesh.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <random>
#include <type_traits>
#include <vector>

#include "../../core/shapes/curve.h"
#include "../../core/shapes/cylinder.h"
#include "../../core/shapes/disk.h"
#include "../../core/shapes/sphere.h"
#include "../../core/shapes/triangle.h"
#include "check.h"

namespace {

using namespace parhelion;
using namespace parhelion::baseline;
// Beside the overloads for long double below.
using baseline::cross;
using baseline::dot;
using baseline::operator+;
using baseline::operator-;
using baseline::operator*;
using Real = long double;

std::mt19937 engine(7);
float uniform() { return static_cast<float>(engine() >> 8) * 0x1p-24f; }
Vec2 uniform2() {
  const float a = uniform();
  return {a, uniform()};
}
Vec3 in_cube(float size) {
  const Vec2 a = uniform2();
  return Vec3{2.0f * a.x - 1.0f, 2.0f * a.y - 1.0f, 2.0f * uniform() - 1.0f} * size;
}
Vec3 any_direction() { return uniform_sphere(uniform2()); }
Ray ray_to(Vec3 from, Vec3 to) { return {from, normalize(to - from), kNoSlot, false}; }

struct Real3 {
  Real x, y, z;
};
Real3 real(Vec3 a) { return {a.x, a.y, a.z}; }
Real3 operator+(Real3 a, Real3 b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
Real3 operator-(Real3 a, Real3 b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
Real3 operator*(Real3 a, Real s) { return {a.x * s, a.y * s, a.z * s}; }
Real dot(Real3 a, Real3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
Real size(Real3 a) { return std::sqrt(dot(a, a)); }
Real3 cross(Real3 a, Real3 b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

bool within(const Box& b, Real3 p) {
  return p.x >= b.low.x && p.y >= b.low.y && p.z >= b.low.z && p.x <= b.high.x && p.y <= b.high.y &&
         p.z <= b.high.z;
}

// --- Blocks
// ---------------------------------------------------------------------------------------

template <class Block>
Block empty_block() {
  Block b;
  std::memset(&b, 0xff, sizeof b);  // NaN, and kNone
  return b;
}
void put(float (&rows)[3][16], u32 lane, Vec3 a) {
  rows[0][lane] = a.x, rows[1][lane] = a.y, rows[2][lane] = a.z;
}
void put(TriangleBlock& b, u32 lane, const Triangle& t) {
  for (int k = 0; k < 3; ++k) put(b.vertex[k], lane, t.vertex[k]);
}
void put(DiskBlock& b, u32 lane, const Disk& d) {
  put(b.center, lane, d.center), put(b.axis_u, lane, d.axis_u), put(b.axis_v, lane, d.axis_v);
}
void put(CylinderBlock& b, u32 lane, const Cylinder& c) {
  put(b.start, lane, c.start), put(b.end, lane, c.end), put(b.side, lane, c.side);
  b.radius[lane] = c.radius;
}
void put(SphereBlock& b, u32 lane, const Sphere& s) {
  b.x[lane] = s.center.x, b.y[lane] = s.center.y, b.z[lane] = s.center.z;
  b.radius[lane] = s.radius;
}
void put(CurveBlock& b, u32 lane, const Curve& c) {
  for (int k = 0; k < 4; ++k) put(b.point[k], lane, c.point[k]), b.radius[k][lane] = c.radius[k];
  b.along[0][lane] = c.along[0], b.along[1][lane] = c.along[1], b.flags[lane] = c.flags;
}

template <class Shape>
struct BlockOf;
template <>
struct BlockOf<Triangle> : std::type_identity<TriangleBlock> {};
template <>
struct BlockOf<Disk> : std::type_identity<DiskBlock> {};
template <>
struct BlockOf<Cylinder> : std::type_identity<CylinderBlock> {};
template <>
struct BlockOf<Sphere> : std::type_identity<SphereBlock> {};
template <>
struct BlockOf<Curve> : std::type_identity<CurveBlock> {};

// Whether a shape alone in its block is hit, and where; other lanes never are.
template <class Shape>
bool hits(const Shape& shape, const Ray& ray, float& t, bool self = false,
          float limit = kInfinity) {
  auto block = empty_block<typename BlockOf<Shape>::type>();
  const u32 lane = engine() & 15u;
  put(block, lane, shape);
  int found = 0;
  intersect(block, ray, limit, self ? lane : kNone, [&](u32 k, float distance) {
    CHECK(k == lane);
    t = distance, ++found;
    return limit;
  });
  CHECK(found <= 1);
  return found != 0;
}

// --- Shapes at random
// -----------------------------------------------------------------------------

Disk any_disk(float radius) {
  const Frame f = frame_around(any_direction());
  return {in_cube(0.6f), f.x * radius, f.y * (radius * (0.05f + uniform()))};
}
Cylinder any_cylinder(float radius, float length) {
  const Frame f = frame_around(any_direction());
  const Vec3 start = in_cube(0.4f);
  return {start, start + f.z * length, f.x, radius};
}
Curve any_curve(float radius, float length, float bend, u32 flags) {
  Curve c;
  const Vec3 step = any_direction() * (length / 3.0f);
  c.point[0] = in_cube(0.3f);
  for (int k = 1; k < 4; ++k) c.point[k] = c.point[k - 1] + step + in_cube(length * bend);
  for (float& r : c.radius) r = radius * (0.8f + 0.4f * uniform());
  c.along[0] = 0.25f, c.along[1] = 0.5f, c.flags = flags;
  return c;
}

// --- Triangles
// ------------------------------------------------------------------------------------

// A ball of uneven triangles, flattened by `squash`: rays from inside, aimed at its vertices, edges
// and faces, always meet it, and so do those that start far away and aim at its middle. What they
// meet lies within its box and on the ray.
void meshes_have_no_gaps(float squash, float radius, Vec3 middle, float far) {
  constexpr u32 kRings = 12, kSectors = 24;
  std::vector<Vec3> v;
  for (u32 i = 0; i <= kRings; ++i) {
    for (u32 j = 0; j < kSectors; ++j) {
      const bool pole = i == 0 || i == kRings;
      const CosSin a = cos_sin_turns(static_cast<float>(i) / (2.0f * kRings));
      const CosSin b = cos_sin_turns(static_cast<float>(j) / kSectors);
      const float r = radius * (pole ? 1.0f : 0.8f + 0.2f * uniform());
      v.push_back(middle + Vec3{a.s * b.c, a.s * b.s, a.c * squash} * r);
    }
  }
  std::vector<std::array<u32, 3>> faces;
  for (u32 i = 0; i < kRings; ++i) {
    for (u32 j = 0; j < kSectors; ++j) {
      u32 a = i * kSectors + j, b = i * kSectors + (j + 1) % kSectors;
      u32 c = a + kSectors, d = b + kSectors;
      if (i == 0) a = b = 0;
      if (i == kRings - 1) c = d = kRings * kSectors;
      if (a != b) faces.push_back({a, c, b});
      if (c != d) faces.push_back({b, c, d});
    }
  }
  std::vector<TriangleBlock> blocks((faces.size() + 15) / 16, empty_block<TriangleBlock>());
  for (size_t i = 0; i < faces.size(); ++i) {
    put(blocks[i / 16], i % 16, {{v[faces[i][0]], v[faces[i][1]], v[faces[i][2]]}});
  }
  for (int i = 0; i < 6000; ++i) {
    const auto& f = faces[engine() % faces.size()];
    const float s = i % 3 == 0 ? 0.0f : i % 3 == 1 ? 0.5f : uniform();
    const Vec3 target = v[f[0]] + (v[f[1]] - v[f[0]]) * s;
    Ray ray = ray_to(middle + Vec3{1, 1, squash} * in_cube(0.25f * radius), target);
    if (far > 0.0f) ray = ray_to(middle - any_direction() * far, middle);
    int found = 0;
    for (const TriangleBlock& block : blocks) {
      intersect(block, ray, kInfinity, kNone, [&](u32 lane, float t) {
        const Triangle triangle = primitive(block, lane);
        SurfacePoint at;
        surface(triangle, ray, t, at);
        CHECK(within(bounds(triangle), real(at.point)));
        CHECK(length(at.point - (ray.origin + ray.direction * t)) < 4e-7f);
        CHECK(std::abs(length(at.normal) - 1.0f) < 1e-6f);
        const Real3 n = cross(real(triangle.vertex[1]) - real(triangle.vertex[0]),
                              real(triangle.vertex[2]) - real(triangle.vertex[0]));
        const Real off = dot(n, real(at.point) - real(triangle.vertex[0])) / size(n);
        CHECK(std::abs(off) <= static_cast<Real>(at.error) + 1e-14L && at.error < 1e-7f);
        const u32 others = ~(1u << lane);
        CHECK(intersect_any(block, ray, t, others));
        CHECK(!intersect_any(block, ray, t * 0.999999f, others));
        ++found;
      });
    }
    CHECK(found >= 1);
  }
}

// Rays that start just before or behind a triangle that they pass through, its vertices lying on
// both sides: met by those that long double has before it.
void what_lies_behind_is_not_met() {
  int told[2] = {};
  for (int i = 0; i < 40000; ++i) {
    const Vec3 middle = in_cube(0.5f);
    const float radius = i % 2 == 0 ? 0.3f : 1e-3f;
    Triangle t;
    for (Vec3& v : t.vertex) v = middle + in_cube(radius);
    const float b = 0.1f + 0.4f * uniform(), c = 0.1f + 0.4f * uniform();
    const Vec3 target =
        t.vertex[0] + (t.vertex[1] - t.vertex[0]) * b + (t.vertex[2] - t.vertex[0]) * c;
    const Vec3 direction = any_direction();
    const float back = radius * std::exp2(-15.0f * uniform()) * (engine() % 2 == 0 ? 1.0f : -1.0f);
    const Ray ray = {target - direction * back, direction, kNoSlot, false};
    const Real3 n =
        cross(real(t.vertex[1]) - real(t.vertex[0]), real(t.vertex[2]) - real(t.vertex[0]));
    const Real at = dot(n, real(t.vertex[0]) - real(ray.origin)) / dot(n, real(direction));
    // Rounding may have moved the start past the plane, or, of what is seen edge-on, past an edge.
    if (std::abs(at - static_cast<Real>(back)) > 0.01L * std::abs(static_cast<Real>(back)))
      continue;
    float distance;
    const bool met = hits(t, ray, distance);
    CHECK(met == (at > 0));
    auto block = empty_block<TriangleBlock>();
    put(block, i % 16, t);
    CHECK(intersect_any(block, ray, kInfinity, 0) == (at > 0));
    if (met) CHECK(std::abs(static_cast<Real>(distance) - at) < 1e-7L * std::abs(at));
    ++told[met ? 1 : 0];
  }
  CHECK(told[0] > 15000 && told[1] > 15000);
}

// A triangle ahead that is seen from its edge is met there, wherever its rounded plane is.
void edges_are_met_ahead() {
  int met = 0;
  for (int i = 0; i < 40000; ++i) {
    const Frame f = frame_around(any_direction());
    const Vec3 a = in_cube(0.3f);
    Triangle t;
    for (Vec3& v : t.vertex) v = a + f.x * (0.1f * uniform()) + f.y * (0.1f * uniform());
    const float u = uniform(), v = uniform() * (1.0f - u);
    const Vec3 target =
        t.vertex[0] + (t.vertex[1] - t.vertex[0]) * u + (t.vertex[2] - t.vertex[0]) * v;
    const Vec3 from = a - f.x * 0.3f;
    const Ray ray = ray_to(from, target);
    float distance;
    const bool hit = hits(t, ray, distance);
    // Sixteen rays at once take all distances in full.
    Rows<Vec3, kLanes> origins, directions;
    float limits[kLanes], distances[kLanes] = {};
    for (u32 k = 0; k < kLanes; ++k) {
      origins.set(k, ray.origin), directions.set(k, ray.direction), limits[k] = kInfinity;
    }
    intersect_rays(t, origins, directions, fastest_axis(ray.direction), limits, distances);
    CHECK(hit == (distances[0] > 0.0f) && (!hit || distance == distances[0]));
    if (!hit) continue;  // few are thick enough to be met
    const int axis = fastest_axis(ray.direction);
    float nearest = kInfinity, farthest = 0.0f;
    for (const Vec3 p : t.vertex) {
      const float at = component(p - from, axis) / component(ray.direction, axis);
      nearest = std::min(nearest, at), farthest = std::max(farthest, at);
    }
    CHECK(distance > nearest * 0.999999f && distance < farthest * 1.000001f);
    ++met;
  }
  CHECK(met > 5000);
}

// Needles a hundred thousand times as long as wide: the point is where long double has it.
void needles_are_met_where_they_are() {
  for (int i = 0; i < 2000; ++i) {
    const Frame f = frame_around(any_direction());
    const Vec3 a = in_cube(0.3f);
    const Triangle t = {{a, a + f.x * 0.6f, a + f.x * (0.6f * uniform()) + f.y * 6e-6f}};
    // Aimed at a point in its middle, from well above its plane.
    const Vec3 target = (t.vertex[0] + t.vertex[1] + t.vertex[2]) * (1.0f / 3.0f);
    const Ray ray = ray_to(target + (f.z + f.x * uniform()) * 1e-3f, target);
    float distance;
    if (!hits(t, ray, distance)) continue;  // rounding may have moved the target off its plane
    const Real3 e1 = real(t.vertex[1]) - real(a), n = cross(e1, real(t.vertex[2]) - real(a));
    const Real exact = dot(n, real(a) - real(ray.origin)) / dot(n, real(ray.direction));
    CHECK(std::abs(static_cast<Real>(distance) - exact) < 2e-7L);
  }
}

// Scenes have them in no block.
void lines_and_points_are_no_triangles() {
  const Vec3 a = {0.125f, 0.25f, 0.5f}, b = {0.25f, 0.5f, 0.25f};
  const Triangle dull[] = {{{a, a, a}}, {{a, a, b}}, {{a, b, a + (b - a) * 2.0f}}};
  for (const Triangle& t : dull) {
    for (int i = 0; i < 1000; ++i) {
      float distance;
      CHECK(!hits(t, ray_to(in_cube(0.9f), a + (b - a) * uniform()), distance));
    }
    CHECK(area(t) == 0.0f && sample_towards(t, {0, 0, 0}, {0.3f, 0.6f}).pdf == 0.0f);
  }
}

void flat_shapes_are_not_met_again() {
  for (int i = 0; i < 2000; ++i) {
    const Disk d = any_disk(0.3f);
    const Triangle t = {{d.center, d.center + d.axis_u, d.center + d.axis_v}};
    float distance;
    CHECK(!hits(d, {d.center + d.axis_v * 0.3f, any_direction(), kNoSlot, true}, distance, true));
    CHECK(!hits(t, {d.center + d.axis_v * 0.3f, any_direction(), kNoSlot, true}, distance, true));
  }
}

// --- Disks and cylinders
// --------------------------------------------------------------------------

void disks_are_met_where_long_double_has_them(float radius) {
  for (int i = 0; i < 3000; ++i) {
    const Disk d = any_disk(radius);
    const Vec3 aim = in_cube(1.3f);
    const Ray ray = ray_to(in_cube(0.9f), d.center + d.axis_u * aim.x + d.axis_v * aim.y);
    const Real3 u = real(d.axis_u), v = real(d.axis_v), n = cross(u, v), c = real(d.center);
    const Real3 f = real(ray.origin) - c;
    const Real t = -dot(n, f) / dot(n, real(ray.direction));
    const Real3 p = f + real(ray.direction) * t;
    const Real a = dot(p, u) / dot(u, u), b = dot(p, v) / dot(v, v), rim = a * a + b * b - 1.0L;
    float distance;
    const bool hit = hits(d, ray, distance);
    if (std::abs(rim) > 1e-9L) CHECK(hit == (rim < 0.0L && t > 0.0L));
    if (!hit) continue;
    CHECK(std::abs(static_cast<Real>(distance) - t) < 1e-7L * t);
    CHECK(within(bounds(d), c + p));
    SurfacePoint at;
    surface(d, ray, distance, at);
    CHECK(size(real(at.point) - c - p) < 1.1e-7L);
    CHECK(std::abs(dot(n, real(at.point) - c)) / size(n) <= static_cast<Real>(at.error) + 1e-16L);
    Vec2 uv;
    Vec3 dpdu, dpdv;
    parametrise(d, at, uv, dpdu, dpdv);
    const CosSin angle = cos_sin_turns(uv.y);
    const Vec3 back = d.center + (d.axis_u * angle.c + d.axis_v * angle.s) * uv.x;
    CHECK(length(back - at.point) < 2e-7f + 1e-5f * radius);
    CHECK(std::abs(dot(dpdu, at.normal)) < 1e-5f * length(dpdu));
    CHECK(dot(cross(dpdu, dpdv), at.normal) > 0.0f);
  }
}

void cylinders_are_met_where_long_double_has_them(float radius, float length_) {
  for (int i = 0; i < 3000; ++i) {
    const Cylinder c = any_cylinder(radius, length_);
    const Vec3 axis = c.end - c.start;
    const Vec3 inside = c.start + axis * uniform();
    const Vec3 aim = c.start + axis * (1.2f * uniform() - 0.1f) + any_direction() * radius;
    const Ray ray = ray_to(i % 4 == 0 ? inside : in_cube(0.9f), aim);
    const Real3 e = real(c.end) - real(c.start), f = real(ray.origin) - real(c.start);
    const Real3 d = real(ray.direction);
    const Real ee = dot(e, e), r = c.radius;
    const Real3 fp = f - e * (dot(f, e) / ee), dp = d - e * (dot(d, e) / ee);
    const Real a = dot(dp, dp), middle = -dot(fp, dp) / a;
    const Real3 nearest = fp + dp * middle;
    const Real chord = r * r - dot(nearest, nearest);
    Real t = -1.0L;
    bool sure = std::abs(chord) > 1e-9L * r * r;
    for (const Real side : {-1.0L, 1.0L}) {
      const Real at = middle + side * std::sqrt(std::max(chord, 0.0L) / a);
      const Real share = (dot(f, e) + at * dot(d, e)) / ee;
      if (std::abs(share) < 1e-6L || std::abs(share - 1.0L) < 1e-6L) sure = false;
      if (chord >= 0.0L && t < 0.0L && at > 0.0L && share >= 0.0L && share <= 1.0L) t = at;
    }
    float distance;
    const bool hit = hits(c, ray, distance);
    if (!sure) continue;
    CHECK(hit == (t > 0.0L));
    if (!hit) continue;
    const Real3 place = real(ray.origin) + d * t, normal = (fp + dp * t) * (1.0L / r);
    CHECK(std::abs(static_cast<Real>(distance) - t) < 2e-7L * t);
    CHECK(within(bounds(c), place));
    SurfacePoint at;
    surface(c, ray, distance, at);
    CHECK(size(real(at.point) - place) < 1.1e-7L);
    CHECK(size(real(at.normal) - normal) < 2e-7L);
    Vec2 uv;
    Vec3 dpdu, dpdv;
    parametrise(c, at, uv, dpdu, dpdv);
    const CosSin angle = cos_sin_turns(uv.x);
    const Vec3 y = cross(normalize(axis), c.side);
    const Vec3 back = c.start + axis * uv.y + (c.side * angle.c + y * angle.s) * c.radius;
    CHECK(length(back - at.point) < 3e-7f + 1e-5f * radius);
    CHECK(dot(cross(dpdu, dpdv), at.normal) > 0.0f);

    // From there on: the far wall if it sets off inwards, nothing otherwise.
    const Vec3 on = any_direction();
    const float cosine = dot(on, at.normal);
    if (radius < 1e-4f || std::abs(cosine) < 0.05f) continue;
    const Ray next = {at.point, on, kNoSlot, cosine < 0.0f};
    const Real3 across = real(on) - e * (dot(real(on), e) / ee);
    const Real far = -2.0L * dot(real(on), normal) * r / dot(across, across);
    const Real end = dot(place + real(on) * far - real(c.start), e) / ee;
    if (std::abs(end) < 1e-2L || std::abs(end - 1.0L) < 1e-2L) continue;
    const bool again = hits(c, next, distance, true);
    CHECK(again == (cosine < 0.0f && end > 0.0L && end < 1.0L));
    if (again) CHECK(std::abs(static_cast<Real>(distance) - far) < 1e-2L * far);
  }
}

// --- Curves
// ---------------------------------------------------------------------------------------

// Round: the first of all spheres along the curve, by trying many and searching around the best.
// Flat: whether the curve, seen along the ray, comes within its radius.
void curves_are_met_where_their_spheres_are(float radius, float length_, float bend, bool flat) {
  constexpr int kSteps = 1000;
  int met = 0, wrong = 0;
  for (int i = 0; i < 400; ++i) {
    const u32 flags = flat ? u32{kCurveFlat} : kCurveCapStart | kCurveCapEnd;
    const Curve c = any_curve(radius, length_, bend, flags);
    const CurveSeen home = seen_along(c, {0, 0, 0}, {0, 0, 1});
    const DVec3 place = jet(home, static_cast<double>(uniform())).p + home.direction * home.start;
    const Vec3 origin = c.point[0] + any_direction() * (length_ * 1.5f + 0.2f);
    const Ray ray = ray_to(origin, to_float(place) + any_direction() * (radius * 1.3f * uniform()));
    const CurveSeen s = seen_along(c, ray.origin, ray.direction);
    double least = 1e30, best = 0.0;  // of the entries, or of the distances from the ray; where
    const auto look = [&](double v) {
      const CurveJet j = jet(s, v);
      const double dd = dot(s.direction, s.direction), middle = dot(j.p, s.direction) / dd;
      const double gap = length(s.direction * middle - j.p);
      const double chord = (j.r * j.r - gap * gap) / dd;
      const double entry = flat ? gap : chord >= 0.0 ? middle - std::sqrt(chord) : 1e6 * gap / j.r;
      if (entry < least) least = entry, best = v;
      return entry;
    };
    for (int k = 0; k <= kSteps; ++k) look(static_cast<double>(k) / kSteps);
    double low = std::max(best - 1.0 / kSteps, 0.0), high = std::min(best + 1.0 / kSteps, 1.0);
    for (int k = 0; k < 60; ++k) {
      const double a = low + (high - low) * 0.382, b = low + (high - low) * 0.618;
      (look(a) < look(b) ? high : low) = look(a) < look(b) ? b : a;
    }
    const double radius_there = jet(s, best).r;
    const double off = flat ? least / radius_there : least < 1e5 ? 0.0 : least * 1e-6;
    float t;
    const bool hit = hits(c, ray, t);
    if (std::abs(off - 1.0) < 1e-5 || (flat && (best < 1e-4 || best > 1.0 - 1e-4))) continue;
    if (hit != (off < 1.0)) ++wrong;
    if (!hit || off >= 1.0) continue;
    ++met;
    if (!flat && std::abs(static_cast<double>(t) - least - s.start) > 2e-7) ++wrong;
    SurfacePoint at;
    surface(c, ray, t, at);
    CHECK(within(bounds(c), real(at.point)));
    CHECK(length(at.point - (ray.origin + ray.direction * t)) < 4e-7f);
    CHECK(std::abs(length(at.normal) - 1.0f) < 1e-6f);
    if (!flat) {
      const DVec3 out = s.direction * least - jet(s, best).p;
      if (best > 1e-3 && best < 1.0 - 1e-3)
        CHECK(dot(to_double(at.normal), out) > 0.999 * radius_there);
      // However far the ray may go, it finds the same.
      for (const float more : {1.0f, 1.0001f, 1.01f, 1.1f, 1.5f}) {
        float again;
        CHECK(hits(c, ray, again, false, t * more) && again == t);
      }
    }
    Vec2 uv;
    Vec3 dpdu, dpdv;
    parametrise(c, at, uv, dpdu, dpdv);
    CHECK(uv.x >= 0.0f && uv.x <= 1.0f && uv.y >= 0.25f && uv.y <= 0.5f);
    CHECK(std::abs(dot(dpdu, at.normal)) <= 1e-5f * length(dpdu));
    CHECK(std::abs(dot(dpdu, dpdv)) <= 1e-4f * length(dpdu) * length(dpdv));
    if (flat) CHECK(at.error > 0.0f && !hits(c, {at.point, any_direction(), {}, false}, t, true));
  }
  CHECK(met > 200 && wrong == 0);
}

// Whoever asks again for what was found, no farther than that, finds it, at the same place.
void curves_are_found_again() {
  for (int i = 0; i < 1000; ++i) {
    const float radius = i % 2 == 0 ? 0.02f : 0.06f;
    const Curve c = any_curve(radius, 0.3f, 0.05f, kCurveCapStart | kCurveCapEnd);
    for (int k = 0; k < 40; ++k) {
      const Vec3 way = any_direction(), from = c.point[1], on = c.point[2] - from;
      const Vec3 at = from + on * uniform() + any_direction() * (radius * 1.5f * uniform());
      const Ray ray = {at - way * 2.0f, way, kNoSlot, false};
      float t, again;
      if (!nearest(c, ray, kInfinity, false, t)) continue;
      CHECK(nearest(c, ray, t, false, again) && again == t);
      CHECK(nearest(c, ray, t * 1.0001f, false, again) && again == t);
      bool same = false;
      meet(c, ray.origin, ray.direction, t, t, [&](const CurveHit& hit) {
        same = same || static_cast<float>(hit.t) == t;
        return false;
      });
      CHECK(same);
    }
  }
}

// Places that are told by their distance are those that all of the curve's would be told by, also
// by one that was rounded as those from farther away are.
void curves_places_are_told_by_distance() {
  int asked = 0, told = 0, told_roughly = 0;
  for (int i = 0; i < 4000; ++i) {
    const bool flat = i % 2 == 0;
    const float radius = i % 4 < 2 ? 0.02f : i % 8 < 4 ? 0.06f : 1e-4f;
    const u32 flags = flat ? u32{kCurveFlat} : kCurveCapStart | kCurveCapEnd;
    const Curve c = any_curve(radius, 0.3f, i % 3 == 0 ? 1e-3f : 0.05f, flags);
    const float far = i % 16 < 8 ? 2.0f : 100.0f;
    for (int k = 0; k < 10; ++k) {
      const Vec3 way = any_direction(), from = c.point[1], on = c.point[2] - from;
      const Vec3 at = from + on * uniform() + any_direction() * (radius * 1.1f * uniform());
      const Ray ray = {at - way * far, way, kNoSlot, false};
      const CurveSeen s = seen_along(c, ray.origin, ray.direction);
      meet(c, ray.origin, ray.direction, 0.0, kInfinity, [&](const CurveHit& hit) {
        const float t = static_cast<float>(hit.t);
        const CurveHit wanted = nearest_met(c, ray, t);
        CurveHit found;
        ++asked;
        if (met_at(s, flat, t, found)) {
          ++told;
          CHECK(found.leaving == wanted.leaving);
          // Less where rays only touch, or see a ribbon along its length
          CHECK(std::abs(found.t - wanted.t) <= t * kCurveUnit);
          CHECK(std::abs(found.v - wanted.v) < 1e-5);
        }
        if (met_at(s, flat, (t + 20.0f) - 20.0f, found)) {
          ++told_roughly;
          CHECK(length(s.way.at(found.v) - s.way.at(wanted.v)) < 1e-5);
        }
        return false;
      });
    }
  }
  CHECK(told > asked * 9 / 10 && told_roughly > asked * 9 / 10);
}

// A ray that only just enters a tube which is nearly straight, and misses the cone around its ends.
void grazed_curves_are_entered() {
  const Curve c = {{{0, 0, 0},
                    {0.333f, 0, 0},
                    {0.671137f, -0.000262f, -0.00517f},
                    {1.0083f, 0.002124f, -0.0125f}},
                   {0.1063f, 0.1026f, 0.0981f, 0.0918f},
                   {0, 1},
                   kCurveCapStart | kCurveCapEnd};
  const Ray ray = {
      {-47.5357f, 6.28805f, 11.3764f}, {0.965541f, -0.1275f, -0.226878f}, kNoSlot, false};
  float t;
  CHECK(hits(c, ray, t) && std::abs(t - 49.85f) < 2e-3f);  // it leaves at 50.0035
}

// Of a block all that are met are told, or only those that are not behind one which was, or one.
void curves_of_a_block_are_met_as_each_alone() {
  int several = 0, spared = 0;
  for (int i = 0; i < 2000; ++i) {
    auto block = empty_block<CurveBlock>();
    Curve curves[16];
    for (u32 k = 0; k < 16; ++k) {
      const u32 flags = i % 2 == 0 ? u32{kCurveFlat} : kCurveCapStart | kCurveCapEnd;
      curves[k] = any_curve(0.03f, 0.4f, i % 4 < 2 ? 1e-3f : 0.1f, flags);
      put(block, k, curves[k]);
    }
    const Ray ray = ray_to(any_direction() * 2.0f, in_cube(0.3f));
    const float limit = i % 3 == 0 ? kInfinity : 1.5f + uniform();
    float alone[16], least = kInfinity;
    u32 met = 0;
    for (u32 k = 0; k < 16; ++k) {
      if (!nearest(curves[k], ray, limit, false, alone[k])) continue;
      met |= 1u << k;
      least = std::min(least, alone[k]);
    }
    u32 all = 0, near = 0, one = 0;
    intersect(block, ray, limit, kNone, [&](u32 k, float t) {
      CHECK((met >> k & 1u) != 0 && t == alone[k]);
      all |= 1u << k;
      return limit;
    });
    CHECK(all == met);
    float best = limit;
    intersect(block, ray, limit, kNone, [&](u32 k, float t) {
      near |= 1u << k;
      return best = std::min(best, t);
    });
    CHECK(near == 0 ? met == 0 : best == least);
    for (u32 k = 0; k < 16; ++k) CHECK((met >> k & 1u) == 0 || alone[k] > best || (near >> k & 1u));
    intersect(block, ray, limit, kNone, [&](u32, float) {
      ++one;
      return 0.0f;
    });
    CHECK(one == (met != 0 ? 1u : 0u));
    several += std::popcount(met) > 1 ? 1 : 0;
    spared += near != met ? 1 : 0;
  }
  CHECK(several > 100 && spared > several / 2);
}

// A straight round curve of one radius is a cylinder.
void straight_curves_are_cylinders() {
  for (int i = 0; i < 1000; ++i) {
    const Cylinder c = any_cylinder(0.05f, 0.5f);
    Curve curve = {{c.start, {}, {}, c.end}, {0.05f, 0.05f, 0.05f, 0.05f}, {0, 1}, 0};
    curve.point[1] = c.start + (c.end - c.start) * (1.0f / 3.0f);
    curve.point[2] = c.start + (c.end - c.start) * (2.0f / 3.0f);
    const Vec3 aim = c.start + (c.end - c.start) * uniform() + any_direction() * 0.05f;
    Ray ray = ray_to(in_cube(0.9f), aim);
    float t, wanted;
    CHECK(hits(c, ray, wanted) == hits(curve, ray, t));
    if (!hits(c, ray, wanted)) continue;
    SurfacePoint at, same;
    surface(c, ray, wanted, at);
    surface(curve, ray, t, same);
    if (dot(at.normal, ray.direction) > -0.1f) continue;  // the points in between are rounded
    CHECK(std::abs(t - wanted) < 5e-7f);
    CHECK(length(at.normal - same.normal) < 1e-5f && length(at.point - same.point) < 3e-7f);
    CHECK(std::abs(at.parameter.y - same.parameter.y) < 1e-5f);
    const Vec3 on = any_direction();
    if (std::abs(dot(on, at.normal)) < 0.05f) continue;
    ray = {at.point, on, kNoSlot, dot(on, at.normal) < 0.0f};
    const bool again = hits(c, ray, wanted, true);
    CHECK(again == hits(curve, ray, t, true));
    if (again) CHECK(std::abs(t - wanted) < 2e-6f);
  }
  const Curve c = any_curve(0.05f, 0.5f, 0.0f, 0);
  CHECK(std::abs(area(c) / (2.0f * kPi * 0.05f * 0.5f) - 1.0f) < 0.25f);
}

// --- Directions towards shapes
// --------------------------------------------------------------------

// Samples and all directions alike give the solid angle, and the distance's mean over it; what is
// sampled is hit, at that distance, and its density is what pdf_towards says.
template <class Shape>
void samples_cover(const Shape& shape, Vec3 from) {
  constexpr int kGrid = 200;
  double angle = 0.0, distance = 0.0, angle_wanted = 0.0, distance_wanted = 0.0;
  int missed = 0;
  for (int i = 0; i < kGrid; ++i) {
    for (int j = 0; j < kGrid; ++j) {
      const auto cell = [&] {
        return Vec2{(static_cast<float>(i) + uniform()) / kGrid,
                    (static_cast<float>(j) + uniform()) / kGrid};
      };
      const TowardsSample s = sample_towards(shape, from, cell());
      float t;
      if (s.pdf > 0.0f) {
        CHECK(s.pdf == pdf_towards(shape, from, s.direction, s.distance, s.normal));
        const bool hit = hits(shape, {from, s.direction, kNoSlot, false}, t);
        if (!hit || std::abs(t - s.distance) > 1e-5f) ++missed;
        angle += 1.0 / s.pdf;
        distance += s.distance / s.pdf;
      }
      if (hits(shape, {from, uniform_sphere(cell()), kNoSlot, false}, t)) {
        angle_wanted += 4.0 * kPi;
        distance_wanted += 4.0 * kPi * t;
      }
    }
  }
  CHECK(missed < kGrid * kGrid / 200);  // at the rim, by rounding
  CHECK(angle_wanted > 0.0);
  CHECK(std::abs(angle / angle_wanted - 1.0) < 0.03);
  CHECK(std::abs(distance / distance_wanted - 1.0) < 0.03);
}

void directions() {
  for (int i = 0; i < 3; ++i) {
    for (const float away : {0.5f, 0.25f}) {
      const Disk d = {in_cube(0.2f), {0.3f, 0, 0}, {0, 0.2f, 0}};
      const Vec3 above = normalize(Vec3{uniform(), uniform(), 0.7f}) * away;
      samples_cover(d, d.center + above);
      samples_cover(Triangle{{d.center, d.center + d.axis_u, d.center + d.axis_v}},
                    d.center + above);
      samples_cover(Sphere{d.center, 0.2f}, d.center + above);
      const Cylinder c = any_cylinder(0.15f, 0.3f);
      samples_cover(c, c.start + c.side * away + (c.end - c.start) * uniform());
    }
  }
  const Cylinder around = any_cylinder(0.15f, 0.3f);
  samples_cover(around, (around.start + around.end) * 0.5f);
  samples_cover(any_curve(0.1f, 0.3f, 0.1f, kCurveCapStart | kCurveCapEnd), {0.7f, 0.7f, 0.7f});
}

// Solid angles of triangles over twelve powers of ten: to rounding, but for what cancels in the
// cosines where a point lies close to an edge.
void solid_angles() {
  int rough = 0;
  for (int i = 0; i < 3000; ++i) {
    const float extent = std::pow(10.0f, -4.0f * uniform());
    const float away = std::pow(10.0f, -3.0f * uniform());
    const Vec3 middle = in_cube(0.3f), from = middle + any_direction() * away;
    Triangle t;
    for (Vec3& v : t.vertex) v = middle + in_cube(extent);
    Real3 w[3];
    for (int k = 0; k < 3; ++k) {
      w[k] = real(t.vertex[k]) - real(from);
      w[k] = w[k] * (1.0L / size(w[k]));
    }
    const Real exact =
        2.0L * std::atan2(std::abs(dot(w[0], cross(w[1], w[2]))),
                          1.0L + dot(w[0], w[1]) + dot(w[1], w[2]) + dot(w[2], w[0]));
    const double height = dot(doubled_area(t), difference(t.vertex[0], from));
    const SphericalTriangle seen = seen_from(t, from, height);
    const Real off = std::abs(static_cast<Real>(seen.solid_angle) / exact - 1.0L);
    CHECK(off < 1e-5L);
    if (off > 4e-7L) ++rough;
  }
  CHECK(rough < 60);
}

// --- Spheres
// --------------------------------------------------------------------------------------

// From outside, from inside and turned away from them; and from where they were met on.
void spheres_are_met_where_long_double_has_them() {
  int met = 0, around = 0, behind = 0, inward = 0;
  for (int i = 0; i < 20000; ++i) {
    const Sphere s = {in_cube(0.5f), i % 3 == 0 ? 0.4f : 0.1f + 0.001f * uniform()};
    const Vec3 origin = s.center + any_direction() * (s.radius * (i % 2 ? 0.9f : 1.1f + uniform()));
    const Ray ray = {origin, any_direction(), kNoSlot, false};
    const Real3 f = real(s.center) - real(ray.origin);
    const Real b = dot(f, real(ray.direction)) / dot(real(ray.direction), real(ray.direction));
    const Real3 off = f - real(ray.direction) * b;
    const Real r = static_cast<Real>(s.radius), under = r * r - dot(off, off);
    if (std::abs(under) < 1e-3L * r * r) continue;  // rounding decides
    const Real root = under > 0.0L ? std::sqrt(under) : 0.0L;
    const Real expected = under < 0.0L ? -1.0L : b - root > 0.0L ? b - root : b + root;
    float t;
    const bool hit = hits(s, ray, t);
    CHECK(hit == (expected > 0.0L));
    if (i % 2) ++around;
    if (!hit) {
      if (under > 0.0L) ++behind;
      continue;
    }
    ++met;
    CHECK(std::abs(static_cast<Real>(t) - expected) < 1e-5L);
    float again;
    CHECK(hits(s, ray, again, false, t) && !hits(s, ray, again, false, t * 0.9999f));

    SurfacePoint at;
    surface(s, ray, t, at);
    const Vec3 on = any_direction();
    const float cosine = dot(on, at.normal);
    if (std::abs(cosine) < 0.05f) continue;
    const bool inwards = cosine < 0.0f;
    CHECK(hits(s, {at.point, on, kNoSlot, inwards}, again, true) == inwards);
    if (!inwards) continue;
    ++inward;
    CHECK(std::abs(again + 2.0f * cosine * s.radius) < 1e-5f);
  }
  CHECK(met > 8000 && around > 8000 && behind > 1000 && inward > 3000);
}

void spheres_have_longitude_and_latitude() {
  const Sphere s = {{0.1f, 0.2f, 0.3f}, 0.25f};
  // Own x is the scene's y, own y its z, own z its x.
  const float rotation[9] = {0, 0, 1, 1, 0, 0, 0, 1, 0};
  const auto uv_at = [&](Vec3 normal) {
    const SurfacePoint at = {s.center + normal * s.radius, normal, {0, 0}, 0.0f};
    Vec2 uv;
    Vec3 dpdu, dpdv;
    parametrise(s, rotation, at, uv, dpdu, dpdv);
    CHECK(std::abs(dot(dpdu, normal)) < 1e-6f && std::abs(dot(dpdv, normal)) < 1e-6f);
    CHECK(std::abs(dot(dpdu, dpdv)) < 1e-6f && dot(cross(dpdu, dpdv), normal) > 0.0f);
    CHECK(std::abs(length(dpdv) - kPi * s.radius) < 1e-6f);
    return uv;
  };
  const auto near = [](Vec2 a, float u, float v) {
    return std::abs(a.x - u) < 1e-6f && std::abs(a.y - v) < 1e-6f;
  };
  CHECK(near(uv_at({0, 1, 0}), 0.0f, 0.5f));
  CHECK(near(uv_at({0, 0, 1}), 0.25f, 0.5f));
  CHECK(near(uv_at({0, 0, -1}), 0.75f, 0.5f));
  CHECK(near(uv_at({1, 0, 0}), 0.0f, 1.0f));
  CHECK(near(uv_at({-1, 0, 0}), 0.0f, 0.0f));
  CHECK(near(uv_at({0.70710678f, 0.70710678f, 0}), 0.0f, 0.75f));
}

}  // namespace

int main() {
  meshes_have_no_gaps(1.0f, 0.9f, {0, 0, 0}, 0.0f);
  meshes_have_no_gaps(1.0f, 0.1f, {0.8f, -0.7f, 0.6f}, 0.0f);
  meshes_have_no_gaps(1e-4f, 0.5f, {0.3f, 0.3f, 0.3f}, 0.0f);
  meshes_have_no_gaps(1.0f, 1e-4f, {0.7f, 0.7f, 0.7f}, 0.0f);
  meshes_have_no_gaps(1.0f, 1e-4f, {0, 0, 0}, 1.0f);  // 1e4 sizes away
  meshes_have_no_gaps(1.0f, 1e-6f, {0.5f, 0.5f, 0}, 0.4f);
  what_lies_behind_is_not_met();
  edges_are_met_ahead();
  needles_are_met_where_they_are();
  lines_and_points_are_no_triangles();
  flat_shapes_are_not_met_again();
  for (const float radius : {0.3f, 1e-3f, 1e-6f}) {
    disks_are_met_where_long_double_has_them(radius);
    cylinders_are_met_where_long_double_has_them(radius, 0.5f);
    cylinders_are_met_where_long_double_has_them(radius, 0.01f);
  }
  for (const bool flat : {false, true}) {
    curves_are_met_where_their_spheres_are(1e-2f, 0.5f, 0.0f, flat);
    curves_are_met_where_their_spheres_are(1e-2f, 0.5f, 1e-3f, flat);  // nearly straight as a whole
    curves_are_met_where_their_spheres_are(1e-2f, 0.5f, 0.1f, flat);
    curves_are_met_where_their_spheres_are(5e-2f, 0.2f, 0.02f, flat);
    curves_are_met_where_their_spheres_are(1e-3f, 0.5f, 0.1f, flat);
    curves_are_met_where_their_spheres_are(2e-3f, 0.02f, 0.05f, flat);
  }
  straight_curves_are_cylinders();
  spheres_are_met_where_long_double_has_them();
  directions();
  solid_angles();
  spheres_have_longitude_and_latitude();
  curves_are_found_again();
  curves_places_are_told_by_distance();
  curves_of_a_block_are_met_as_each_alone();
  grazed_curves_are_entered();
  std::printf(failures == 0 ? "shapes: ok\n" : "shapes: %d failures\n", failures);
  return failures != 0;
}
