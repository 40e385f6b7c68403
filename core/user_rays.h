// Rays of users: what they give, in double and anywhere, becomes rays of the kernels, of unit
// length and in normalised units, from where they enter the scene's bounds, since float is too
// coarse far away; what these have met is kept for those that set off from there.
#pragma once
#include "camera.h"

namespace parhelion {

// By component. limit: how far is looked, in lengths and not in directions'.
struct UserBatch {
  alignas(64) double origin[3][kBatch], direction[3][kBatch], limit[kBatch];
};

// A ray, and what it has met: all that it takes to tell the point when that is asked for. The hit's
// leaf is kNone, and its distance means nothing, where nothing is met. Normalised units.
struct HitRay {
  Vec3 origin, direction;
  Hit hit;
};

// The point of a surface that a ray has met: all that it takes to set off from there without
// meeting the same surface again. Normalised units; NaN where nothing is met.
struct Met {
  Slot slot;
  Vec3 point, normal;  // outward, unit
  float error;         // the true surface is no farther from the point
  u32 inside_out;      // whether the shape's inside is where its normals point to
};

}  // namespace parhelion

namespace parhelion::PH_ISA {

// Beyond float, infinite: a conversion has no meaning there.
PH_INLINE float rounded(double x) {
  constexpr double kMost = 0x1.fffffep127;
  const float beyond = x < 0.0 ? -kInfinity : kInfinity;
  return abs(x) <= kMost ? static_cast<float>(x) : beyond;
}
// The greatest float that is no more than a number >= 0.
PH_INLINE float below(double x) {
  const float f = rounded(x);
  const u32 bits = __builtin_bit_cast(u32, f);
  return __builtin_bit_cast(float, static_cast<double>(f) > x ? bits - 1 : bits);
}

PH_INLINE DVec3 row_at(const double (&rows)[3][kBatch], u32 k) {
  return {rows[0][k], rows[1][k], rows[2][k]};
}

// False if some of them, or their squares, are 0 or beyond double's range: those that are a number
// and not 0 become units none the less.
PH_APART inline bool make_unit(double (&__restrict of)[3][kBatch]) {
  const auto plain = [](double square) { return (square > 0x1p-900) & (square < 0x1p900); };
  double square[kBatch];
  u64 strange = 0;
  for (u32 k = 0; k < kBatch; ++k) {
    square[k] = dot(row_at(of, k), row_at(of, k));
    strange |= plain(square[k]) ? u64{0} : u64{1};
  }
  for (u32 k = 0; strange != 0 && k < kBatch; ++k) {
    if (plain(square[k])) continue;
    double most = abs(of[0][k]);
    for (u32 axis = 1; axis < 3; ++axis) most = abs(of[axis][k]) > most ? abs(of[axis][k]) : most;
    for (auto& row : of) row[k] /= most;
    square[k] = dot(row_at(of, k), row_at(of, k));
  }
  for (u32 k = 0; k < kBatch; ++k) {
    const double inverse = 1.0 / compiler::sqrt(square[k]);
    for (u32 axis = 0; axis < 3; ++axis) of[axis][k] *= inverse;
  }
  return strange == 0;
}

// Where rays enter the scene's bounds, and how far that is from where they are. What passes the
// bounds by enters them after infinity. False if some origins are no numbers.
PH_APART inline bool enter(const Box& bounds, double scale, const UserBatch& __restrict users,
                           RayBatch& __restrict rays, double (&__restrict far)[kBatch]) {
  u64 strange = 0;
  double from[3][kBatch];
  for (u32 axis = 0; axis < 3; ++axis) {
    for (u32 k = 0; k < kBatch; ++k) {
      const double o = users.origin[axis][k];
      from[axis][k] = o * scale;
      strange |= o - o == 0.0 ? u64{0} : u64{1};
    }
  }
  const auto within = [&](DVec3 o) {
    return (o.x >= bounds.low.x) & (o.x <= bounds.high.x) & (o.y >= bounds.low.y) &
           (o.y <= bounds.high.y) & (o.z >= bounds.low.z) & (o.z <= bounds.high.z);
  };
  u64 outside = 0;
  for (u32 k = 0; k < kBatch; ++k) {
    outside |= within(row_at(from, k)) ? u64{0} : u64{1};
    far[k] = 0.0;
  }
  for (u32 k = 0; outside != 0 && k < kBatch; ++k) {
    const DVec3 o = row_at(from, k);
    const double there = entry(o, row_at(users.direction, k), bounds);
    far[k] = within(o) ? 0.0 : there;
  }
  const double infinity = static_cast<double>(kInfinity);
  for (u32 axis = 0; axis < 3; ++axis) {
    for (u32 k = 0; k < kBatch; ++k) {
      const double there = from[axis][k] + users.direction[axis][k] * far[k];
      rays.origin[axis][k] = far[k] < infinity ? rounded(there) : 0.0f;
    }
  }
  return strange == 0;
}

// Rays that begin `skipped` away from where they were given, which `scale` takes to normalised
// units: with limits, and directions, whose lengths are 1 in `users` then; and, if they are to
// enter the scene from there, with origins. False if some of them may be no rays.
PH_APART inline bool begin_rays(const Box& bounds, double scale, bool enters,
                                UserBatch& __restrict users, RayBatch& __restrict rays,
                                double (&__restrict skipped)[kBatch]) {
  bool plain = make_unit(users.direction);
  for (u32 axis = 0; axis < 3; ++axis) {
    for (u32 k = 0; k < kBatch; ++k) {
      rays.direction[axis][k] = static_cast<float>(users.direction[axis][k]);
    }
  }
  for (double& s : skipped) s = 0.0;
  if (enters) plain &= enter(bounds, scale, users, rays, skipped);
  u64 strange = 0;
  for (u32 k = 0; k < kBatch; ++k) {
    strange |= users.limit[k] >= 0.0 ? u64{0} : u64{1};
    // What was told of a hit, as a limit, leads back to it in spite of its rounding.
    const double left = users.limit[k] * scale * (1.0 + 0x1p-52) - skipped[k];
    const bool passes = !(skipped[k] < static_cast<double>(kInfinity));
    rays.limit[k] = passes ? 0.0f : below(left > 0.0 ? left : 0.0);
  }
  return plain && strange == 0;
}

}  // namespace parhelion::PH_ISA
