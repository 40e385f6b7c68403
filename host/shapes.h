// From the user's arrays to primitives, boxes and lanes of blocks, alike for every kind of shape: a
// primitive's struct holds nothing but lengths, in the order of the user's arrays, and its block
// the same numbers in rows of sixteen.
#pragma once
#include <cmath>
#include <cstring>
#include <limits>

#include "build.h"
#include "scene.h"

namespace parhelion {

// Primitive i of a shape, its lengths times `scale`.
template <class Shape>
Shape make_primitive(const ShapeInput& s, size_t i, double scale) {
  constexpr size_t kFloats = sizeof(Shape) / sizeof(float);
  float values[kFloats];
  size_t n = 0;
  for (const Numbers& a : s.arrays) {
    for (int k = 0; k < a.columns && n < kFloats; ++k) {
      values[n++] = static_cast<float>(a.at(i, k) * scale);
    }
  }
  Shape shape;
  std::memcpy(&shape, values, sizeof shape);
  return shape;
}

// Row i of an array of points.
inline Vec3 point_of(const Numbers& points, size_t i, double scale) {
  const auto scaled = [&](const auto* p) {
    const auto at = [&](int k) { return static_cast<float>(static_cast<double>(p[k]) * scale); };
    return Vec3{at(0), at(1), at(2)};
  };
  const void* row = points.row(i);
  return points.is_double ? scaled(static_cast<const double*>(row))
                          : scaled(static_cast<const float*>(row));
}

template <>
inline baseline::Sphere make_primitive<baseline::Sphere>(const ShapeInput& s, size_t i,
                                                         double scale) {
  return {point_of(s.arrays[0], i, scale), static_cast<float>(s.arrays[1].at(i, 0) * scale)};
}

// Three vertices of a mesh.
template <>
inline baseline::Triangle make_primitive<baseline::Triangle>(const ShapeInput& s, size_t i,
                                                             double scale) {
  baseline::Triangle t;
  for (size_t k = 0; k < 3; ++k) t.vertex[k] = point_of(s.arrays[0], s.faces[3 * i + k], scale);
  return t;
}

// The direction of u = 0 is no length.
template <>
inline baseline::Cylinder make_primitive<baseline::Cylinder>(const ShapeInput& s, size_t i,
                                                             double scale) {
  return {point_of(s.arrays[0], i, scale), point_of(s.arrays[1], i, scale),
          point_of(s.arrays[2], i, 1.0), static_cast<float>(s.arrays[3].at(i, 0) * scale)};
}

// Shares of a strand and flags are no lengths.
template <>
inline baseline::Curve make_primitive<baseline::Curve>(const ShapeInput& s, size_t i,
                                                       double scale) {
  const auto number = [&](const Numbers& a, size_t k, double factor) {
    return static_cast<float>(a.at(i, static_cast<int>(k)) * factor);
  };
  baseline::Curve c;
  for (size_t k = 0; k < 4; ++k) {
    c.point[k] = {number(s.arrays[0], 3 * k, scale), number(s.arrays[0], 3 * k + 1, scale),
                  number(s.arrays[0], 3 * k + 2, scale)};
    c.radius[k] = number(s.arrays[1], k, scale);
  }
  for (size_t k = 0; k < 2; ++k) c.along[k] = number(s.arrays[2], k, 1.0);
  c.flags = static_cast<u32>(s.arrays[3].at(i, 0));
  return c;
}

// Padded by the rounding of the primitive's own test.
template <class Shape>
Aabb box_of(const Shape& shape) {
  const Box b = bounds(shape);
  return {{b.low.x, b.low.y, b.low.z}, {b.high.x, b.high.y, b.high.z}};
}

// A centre's distance from a ray's origin within the scene is rounded.
template <>
inline Aabb box_of(const baseline::Sphere& s) {
  const float center[3] = {s.center.x, s.center.y, s.center.z};
  Aabb b;
  for (int k = 0; k < 3; ++k) {
    const float half = s.radius + (std::fabs(center[k]) + s.radius) * 0x1p-21f;
    b.low[k] = center[k] - half;
    b.high[k] = center[k] + half;
  }
  return b;
}

template <class Block>
Block empty_block() {
  Block b;
  float* values = reinterpret_cast<float*>(&b);
  for (size_t i = 0; i < offsetof(Block, id) / sizeof(float); ++i) {
    values[i] = std::numeric_limits<float>::quiet_NaN();
  }
  for (u32& id : b.id) id = kNone;
  return b;
}

template <class Block, class Shape>
void put(Block& block, size_t lane, const Shape& shape, u32 id) {
  static_assert(offsetof(Block, id) == 16 * sizeof(Shape));
  float values[sizeof(Shape) / sizeof(float)];
  std::memcpy(values, &shape, sizeof shape);
  float* rows = reinterpret_cast<float*>(&block);
  for (size_t k = 0; k < sizeof(Shape) / sizeof(float); ++k) rows[16 * k + lane] = values[k];
  block.id[lane] = id;
}

// Which of a leaf's primitives are left out of it, a bit for each. Of spheres that coincide, the
// one of the lowest id stands for all: a ray that starts on one would otherwise meet its twin at
// once, or not, as rounding has it. Centres that coincide share a leaf unless there are more of
// them than it holds.
inline u32 left_out(const baseline::Sphere* spheres, const u32* ids, size_t n) {
  u32 twins = 0;
  for (size_t i = 1; i < n; ++i) {
    const baseline::Sphere& s = spheres[i];
    for (size_t k = 0; k < i; ++k) {
      const baseline::Sphere& o = spheres[k];
      if (o.center.x == s.center.x && o.center.y == s.center.y && o.center.z == s.center.z &&
          o.radius == s.radius) {
        twins |= 1u << (ids[k] < ids[i] ? i : k);
      }
    }
  }
  return twins;
}
// Triangles that are mere lines, which nothing meets.
inline u32 left_out(const baseline::Triangle* triangles, const u32*, size_t n) {
  u32 lines = 0;
  for (size_t i = 0; i < n; ++i) {
    const auto normal = baseline::doubled_area(triangles[i]);
    if (normal.x == 0.0 && normal.y == 0.0 && normal.z == 0.0) lines |= 1u << i;
  }
  return lines;
}
template <class Shape>
u32 left_out(const Shape*, const u32*, size_t) {
  return 0;
}

}  // namespace parhelion
