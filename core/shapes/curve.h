// Segments of curves, sixteen to a block: cubic Bezier curves c(v), 0 <= v <= 1, of a radius r(v)
// that is a cubic too.
//
// A round one is the hull of the spheres of radius r(v) around c(v): a tube, whose ends are open or
// round. A point p of it has |p - c|^2 = r^2 and, since the spheres' surfaces slip along the hull,
// (p - c).c' + r r' = 0; its normal is (p - c) / r. A flat one is a ribbon that turns to face the
// ray: all places within r of the curve as the ray sees it. Linear and B-spline curves are Bezier
// curves as well.
//
// Unless the whole is nearly straight and of nearly even taper, sixteen pieces of the curve are
// tested at once, in float, for whether the ray passes them by, and what is left is halved until it
// is. There a cone's equation gives a first guess, and Newton's method the place on the curve
// itself. In the spirit of T. Reshetov and D. Luebke, "Phantom Ray-Hair Intersector", HPG 2018, for
// the cones, and of K. Nakamaru and Y. Ohno, "Ray Tracing for Curves Primitive", WSCG 2002, for the
// halving. All but that first test is in double, so that hairs may be thin and far away.
#pragma once
#include "point.h"
#include "sphere.h"

namespace parhelion {

enum CurveFlag : u32 {
  kCurveFlat = 1,      // else round
  kCurveCapStart = 2,  // a round one ends in a half sphere, else it is open
  kCurveCapEnd = 4,
};

// Control points by number, axis and lane, radii by number and lane; NaN in unused lanes. along:
// the segment's two ends as shares of the way along its strand. flags: sums of CurveFlag.
struct alignas(64) CurveBlock {
  float point[4][3][16], radius[4][16], along[2][16];
  u32 flags[16];
  u32 id[16];
};

}  // namespace parhelion

namespace parhelion::PH_ISA {

struct Curve {
  Vec3 point[4];
  float radius[4];
  float along[2];
  u32 flags;

  static constexpr bool found_alone = true;  // surface() has branches (wavefront/surfaces.h)
};

PH_INLINE Curve primitive(const CurveBlock& block, u32 lane) {
  Curve c;
  for (int k = 0; k < 4; ++k) {
    c.point[k] = vector_at(block.point[k], lane);
    c.radius[k] = block.radius[k][lane];
  }
  c.along[0] = block.along[0][lane];
  c.along[1] = block.along[1][lane];
  c.flags = block.flags[lane];
  return c;
}

PH_INLINE float widest(const Curve& c) {
  return max(max(c.radius[0], c.radius[1]), max(c.radius[2], c.radius[3]));
}

// A Bezier curve lies within the hull of its control points.
PH_INLINE Box bounds(const Curve& c) {
  const float r = widest(c);
  return rounded_out(min(min(c.point[0], c.point[1]), min(c.point[2], c.point[3])) - Vec3{r, r, r},
                     max(max(c.point[0], c.point[1]), max(c.point[2], c.point[3])) + Vec3{r, r, r});
}

// A cubic by the powers of v, with slope and curvature 14 operations where its control points take
// 24.
template <class T>
struct CurveCubic {
  T of[4];

  PH_INLINE T at(double v) const { return of[0] + (of[1] + (of[2] + of[3] * v) * v) * v; }
  PH_INLINE T slope(double v) const { return of[1] + (of[2] * 2.0 + of[3] * (3.0 * v)) * v; }
  PH_INLINE T curvature(double v) const { return of[2] * 2.0 + of[3] * (6.0 * v); }
};
template <class T>
PH_INLINE CurveCubic<T> cubic_of(const T (&c)[4]) {
  const T first = c[1] - c[0], second = c[2] - c[1] - first;
  return {{c[0], first * 3.0, second * 3.0, c[3] - c[0] - (first + second) * 3.0}};
}

// The same with the point of the ray that is nearest to the curve's middle as origin. The direction
// is of unit length but for rounding.
struct CurveSeen {
  DVec3 point[4];  // control points, and their radii
  double radius[4];
  CurveCubic<DVec3> way;
  CurveCubic<double> width;
  DVec3 direction;
  double start;  // distance of that point along the ray
};

PH_INLINE CurveSeen seen_along(const Curve& c, Vec3 origin, Vec3 direction) {
  CurveSeen s;
  s.direction = to_double(direction);
  DVec3 sum = {0, 0, 0};
  for (int k = 0; k < 4; ++k) {
    s.point[k] = difference(c.point[k], origin);
    s.radius[k] = c.radius[k];
    sum = sum + s.point[k];
  }
  s.start = 0.25 * dot(sum, s.direction);
  for (DVec3& p : s.point) p = p - s.direction * s.start;
  s.way = cubic_of(s.point);
  s.width = cubic_of(s.radius);
  return s;
}

// Position and radius at v, and their first and second derivatives.
struct CurveJet {
  DVec3 p, p1, p2;
  double r, r1, r2;
};

PH_INLINE CurveJet jet(const CurveSeen& c, double v) {
  return {c.way.at(v),   c.way.slope(v),   c.way.curvature(v),
          c.width.at(v), c.width.slope(v), c.width.curvature(v)};
}

// Control points of the piece from a to b: its ends, and from each a third of the way that the
// curve's slope there leads.
template <class T>
PH_INLINE void piece_of(const CurveCubic<T>& c, double a, double b, T (&piece)[4]) {
  const double third = (b - a) / 3.0;
  piece[0] = c.at(a);
  piece[1] = piece[0] + c.slope(a) * third;
  piece[3] = c.at(b);
  piece[2] = piece[3] - c.slope(b) * third;
}

// A place where a ray meets a curve. leaving: from inside.
struct CurveHit {
  double t, v;
  bool leaving;
};

// Newton's method has arrived when the next move is expected to be less than this share of the
// radius: each is about as large, beside the square of the one before it, as the next will be
// beside its own square. Where the ray only touches the surface more may be left, 1e-4 at most of 4
// million.
inline constexpr double kCurvePrecision = 1e-9;
// The squares of a move, of the one before it, and of the radius. After the first move one of 1e-6
// leaves less.
PH_INLINE bool has_arrived(double move, double last, double radius) {
  constexpr double kSquare = kCurvePrecision * kCurvePrecision;
  return move <= 1e-12 * radius || move * move * move <= kSquare * radius * (last * last);
}
// Neighbours overlap by this share of a segment, that rounding leave no gap between them.
inline constexpr double kCurveOverlap = 1e-7;

// From a guess to the place on the tube; t counts from c.start.
inline bool refine_round(const CurveSeen& c, double& t, double& v) {
  double last = 0.0;
  for (int i = 0; i < 24; ++i) {
    const CurveJet j = jet(c, v);
    const DVec3 p = c.direction * t - j.p;
    const double slip = dot(p, j.p1) + j.r * j.r1;
    const double depth = 0.5 * (dot(p, p) - j.r * j.r);
    const double slip_v = dot(p, j.p2) - dot(j.p1, j.p1) + j.r1 * j.r1 + j.r * j.r2;
    const double slip_t = dot(c.direction, j.p1), depth_t = dot(c.direction, p);
    const double determinant = -slip_t * slip - slip_v * depth_t;  // d depth / dv is -slip
    const double dt = (slip * slip + slip_v * depth) / determinant;
    const double dv = clamp((depth_t * slip - slip_t * depth) / determinant, -0.25, 0.25);
    t += dt;
    v += dv;
    if (!(v > -0.5 && v < 1.5)) return false;  // or not a number
    const double move = dt * dt + dv * dv * dot(j.p1, j.p1);
    if (has_arrived(move, last, j.r * j.r)) return true;
    last = move;
  }
  return false;
}

// From a guess to where the curve, as the ray sees it, is nearest to the ray.
inline bool refine_flat(const CurveSeen& c, double& t, double& v) {
  const DVec3 d = c.direction;
  const double shorter = 1.0 / dot(d, d);  // what makes shares of d of lengths along it
  double last = 0.0;
  for (int i = 0; i < 24; ++i) {
    const CurveJet j = jet(c, v);
    const DVec3 q = j.p - d * (dot(j.p, d) * shorter), q1 = j.p1 - d * (dot(j.p1, d) * shorter);
    const double slope = dot(q1, q1) + dot(q, j.p2);
    if (!(slope > 0.0)) return false;  // farthest, not nearest
    const double dv = clamp(-dot(q, q1) / slope, -0.25, 0.25);
    v += dv;
    if (!(v > -0.5 && v < 1.5)) return false;
    const double move = dv * dv * dot(q1, q1);
    if (!has_arrived(move, last, j.r * j.r)) {
      last = move;
      continue;
    }
    const CurveJet at = jet(c, v);
    t = dot(at.p, d) * shorter;
    const DVec3 off = at.p - d * t;
    return dot(off, off) <= at.r * at.r;
  }
  return false;
}

// Calls accept(hit) for each place where the ray meets the half sphere at an end.
template <class F>
inline void meet_cap(const CurveSeen& c, bool end, F&& accept) {
  const int first = end ? 3 : 0, step = end ? -1 : 1;
  const DVec3 center = c.point[first];
  const double r = c.radius[first];
  // The way on from the end, by the next control point that differs.
  int next = first + step;
  DVec3 on = c.point[next] - center;
  while (dot(on, on) == 0.0 && next != 3 - first) on = c.point[next += step] - center;
  const double widening = r * (c.radius[next] - r);
  const DVec3 d = c.direction;
  const double dd = dot(d, d), b = dot(d, center) / dd;
  const DVec3 off = d * b - center;
  const double discriminant = (r * r - dot(off, off)) / dd;
  if (!(discriminant >= 0.0)) return;
  const double half = compiler::sqrt(discriminant);
  for (int i = 0; i < 2; ++i) {
    const double t = i == 0 ? b - half : b + half;
    const double slip = dot(d * t - center, on) + widening;
    if (slip <= kCurveOverlap * dot(on, on)) accept(CurveHit{t + c.start, end ? 1.0 : 0.0, i == 1});
  }
}

// A piece counts as nearly straight when it bends by less than this share of its length and radius;
// a whole curve by less than the other: by a tenth, 20 of a million rays were told of their exit
// where they barely enter.
inline constexpr double kCurveStraight = 0.1, kCurveStraightAsWhole = 0.02;

// A piece of a curve, from v = a to b, with its control points.
struct CurvePiece {
  double a, b;
  DVec3 point[4];
  double radius[4];
  double widest;
  double bend;  // and change of taper: the length of the control points' second differences
  double room;  // what it has to be small beside
};

// Works out the rest of a piece from its control points.
PH_INLINE void look_at(CurvePiece& piece, bool flat) {
  const DVec3(&p)[4] = piece.point;
  const double (&r)[4] = piece.radius;
  const DVec3 m = p[0] - p[1] * 2.0 + p[2], n = p[1] - p[2] * 2.0 + p[3];
  const double k = r[0] - 2.0 * r[1] + r[2], l = r[1] - 2.0 * r[2] + r[3];
  piece.bend = compiler::sqrt(dot(m, m) + dot(n, n) + k * k + l * l);
  // The hull of spheres that grow nearly as fast as they move is as sensitive as they differ.
  const double way = length(p[3] - p[0]);
  piece.room = flat ? way : abs(way - abs(r[3] - r[0]));
  piece.widest = r[0];
  PH_UNROLL
  for (int i = 0; i < 4; ++i) {
    piece.room = r[i] < piece.room ? r[i] : piece.room;
    piece.widest = r[i] > piece.widest ? r[i] : piece.widest;
  }
}

PH_INLINE CurvePiece whole(const CurveSeen& c, bool flat) {
  CurvePiece piece;
  piece.a = 0.0;
  piece.b = 1.0;
  PH_UNROLL
  for (int k = 0; k < 4; ++k) {
    piece.point[k] = c.point[k];
    piece.radius[k] = c.radius[k];
  }
  look_at(piece, flat);
  return piece;
}

// How places where a ray meets a piece were found.
enum class PieceMet {
  surely,
  barely,  // the ray only just meets the cone, or lies along it: some may be missing
  astray,  // where a guess has been led: a smaller piece would make better ones
};

// Calls accept(hit) for the places where the ray meets a nearly straight piece, in no order. accept
// returns whether it has taken the hit; then the farther of two may be left out.
template <class F>
inline PieceMet meet_piece(const CurveSeen& c, bool flat, const CurvePiece& piece, F&& accept) {
  const double a = piece.a, b = piece.b;
  const DVec3(&point)[4] = piece.point;
  const double (&radius)[4] = piece.radius;
  const DVec3 d = c.direction, e = point[3] - point[0];
  const double dd = dot(d, d), de = dot(d, e);
  // How far outside of the piece, in its lengths, a guess may lie.
  const double margin = 0.25 + 2.0 * piece.bend * piece.widest / dot(e, e);
  double taken = static_cast<double>(kInfinity);  // the last place that was
  const auto offer = [&](double t, double share) {
    if (!(share >= -margin && share <= 1.0 + margin)) return true;
    double v = a + share * (b - a);
    if (!(flat ? refine_flat(c, t, v) : refine_round(c, t, v))) return false;
    if (v >= -kCurveOverlap && v <= 1.0 + kCurveOverlap) {
      const CurveJet j = jet(c, v);
      const bool leaving = !flat && dot(c.direction * t - j.p, c.direction) > 0.0;
      if (accept(CurveHit{t + c.start, clamp(v, 0.0, 1.0), leaving})) taken = t;
    }
    return abs(v - 0.5 * (a + b)) <= (0.5 + margin) * (b - a);
  };
  if (flat) {
    const DVec3 q = point[0] - d * (dot(point[0], d) / dd), across = e - d * (de / dd);
    offer(0.0, clamp(-dot(q, across) / dot(across, across), 0.0, 1.0));
    return PieceMet::surely;
  }
  // The cone around the two end spheres: the places w, counted from the first centre, where
  // |w|^2 - r^2 - (w.e + r dr)^2 / (e.e - dr^2) is 0.
  const double r = radius[0], dr = radius[3] - r;
  const double wide = dot(e, e) - dr * dr, over_wide = 1.0 / wide;
  const DVec3 w = point[0] * -1.0;
  const double we = dot(w, e) + r * dr;
  const double A = dd - de * de * over_wide, B = dot(w, d) - we * de * over_wide;
  const double C = dot(w, w) - r * r - we * we * over_wide;
  const double discriminant = B * B - A * C;
  // A ray that just misses the cone may still meet the curved piece: start where it is nearest. But
  // both lie within the cone of spheres that are larger by what the piece bends: control points
  // are off the straight line by at most sqrt(5) / 3 of that, and so in position and radius
  // together is the curve by less than that.
  const bool pierced = discriminant > 0.0;
  if (!pierced && wide > 0.0) {
    const double more = we + piece.bend * dr, wider = B + (we - more) * de * over_wide;
    const double rest =
        C - piece.bend * (2.0 * r + piece.bend) + (we * we - more * more) * over_wide;
    if (wider * wider - A * rest < 0.0) return PieceMet::surely;
  }
  const double half = pierced ? compiler::sqrt(discriminant) : 0.1 * abs(A) * r;
  const double over_A = 1.0 / A, t0 = (-B - half) * over_A, t1 = (-B + half) * over_A;
  const bool first = offer(t0, (we + t0 * de) * over_wide);
  const bool along = dot(e, e) * dd - de * de <= 16.0 * piece.bend * piece.bend * dd;
  const PieceMet met = pierced && !along ? PieceMet::surely : PieceMet::barely;
  // What was found by the nearer guess, and closer to it than to the other.
  if (first && t0 < t1 && taken < 0.5 * (t0 + t1)) return met;
  const bool second = offer(t1, (we + t1 * de) * over_wide);
  return first && second ? met : pierced ? PieceMet::astray : PieceMet::barely;
}

// Where sixteen pieces of equal steps of v begin and end: what each control point weighs there.
struct PieceWeights {
  float of[4][2][16];
};
constexpr PieceWeights piece_weights() {
  PieceWeights w = {};
  for (int k = 0; k < 16; ++k) {
    for (int end = 0; end < 2; ++end) {
      const double v = (k + end) / 16.0, u = 1.0 - v;
      const double of[4] = {u * u * u, 3.0 * u * u * v, 3.0 * u * v * v, v * v * v};
      for (int i = 0; i < 4; ++i) w.of[i][end][k] = static_cast<float>(of[i]);
    }
  }
  return w;
}
alignas(64) PH_TABLE PieceWeights kPieceWeights = piece_weights();

// What sixteen curves, or pieces, lie around, as rays along z see it that go through the origin:
// the hulls of some points, from the first way to the last, and how far from these they reach.
template <int kPoints>
struct HullsSeen {
  Lanes x[kPoints], y[kPoints], z[kPoints], reach;
};
// Whether the rays' lines pass through the hulls: these are held against lines along and across the
// way from first to last point, between which what is thin is narrow, however it lies.
template <int kPoints>
PH_INLINE LaneMask hulls_met(const HullsSeen<kPoints>& h) {
  constexpr int kLast = kPoints - 1;
  const Lanes along_x = h.x[kLast] - h.x[0], along_y = h.y[kLast] - h.y[0];
  Lanes low[2], high[2];
  for (int k = 0; k < kPoints; ++k) {
    const Lanes at[2] = {along_x * h.x[k] + along_y * h.y[k], along_x * h.y[k] - along_y * h.x[k]};
    for (int i = 0; i < 2; ++i) {
      low[i] = k == 0 ? at[i] : min(low[i], at[i]);
      high[i] = k == 0 ? at[i] : max(high[i], at[i]);
    }
  }
  const Lanes reach = h.reach * sqrt(along_x * along_x + along_y * along_y);
  const Lanes back = all(0.0f) - reach;
  return (low[0] <= reach) & (back <= high[0]) & (low[1] <= reach) & (back <= high[1]);
}
// The distances along the rays between which the hulls lie.
template <int kPoints>
PH_INLINE Lanes begin_of(const HullsSeen<kPoints>& h) {
  Lanes low = h.z[0];
  for (int k = 1; k < kPoints; ++k) low = min(low, h.z[k]);
  return low - h.reach;
}
template <int kPoints>
PH_INLINE Lanes end_of(const HullsSeen<kPoints>& h) {
  Lanes high = h.z[0];
  for (int k = 1; k < kPoints; ++k) high = max(high, h.z[k]);
  return high + h.reach;
}

// The pieces, as bits, that the ray's line may meet, and those that it may meet between two
// distances.
struct PiecesMet {
  u32 met, within;
};
PH_INLINE PiecesMet pieces_met(const CurveSeen& c, const Frame& frame, double bend, double nearest,
                               double farthest) {
  const DVec3 axis[3] = {to_double(frame.x), to_double(frame.y), c.direction};
  HullsSeen<2> h;
  Lanes radius[2];
  double extent = 0.0;
  for (int i = 0; i < 4; ++i) {
    extent += abs(c.point[i].x) + abs(c.point[i].y) + abs(c.point[i].z);
    const Lanes x = all(static_cast<float>(dot(c.point[i], axis[0])));
    const Lanes y = all(static_cast<float>(dot(c.point[i], axis[1])));
    const Lanes z = all(static_cast<float>(dot(c.point[i], axis[2])));
    const Lanes r = all(static_cast<float>(c.radius[i]));
    for (int j = 0; j < 2; ++j) {
      const Lanes w = load(kPieceWeights.of[i][j]);
      h.x[j] = i == 0 ? x * w : h.x[j] + x * w;
      h.y[j] = i == 0 ? y * w : h.y[j] + y * w;
      h.z[j] = i == 0 ? z * w : h.z[j] + z * w;
      radius[j] = i == 0 ? r * w : radius[j] + r * w;
    }
  }
  // Between its ends a piece is off the straight line by an eighth of the square of its share of v
  // times the second derivative, which is at most 6 times a second difference; position and radius
  // together by sqrt(2) of that. The frame is orthonormal to 1e-6, and sums of four and products
  // are rounded by less than 3e-6 of the control points.
  constexpr double kBulge = 6.0 / (8.0 * 16.0 * 16.0) * 1.4143;
  h.reach = max(radius[0], radius[1]) * all(1.0f + 1e-5f) +
            all(static_cast<float>(kBulge * bend + 4e-6 * extent));
  const double room = 2e-7 * abs(c.start);
  const Lanes from = all(static_cast<float>(nearest - c.start - room));
  const Lanes to = all(static_cast<float>(farthest - c.start + room));
  const u32 met = bits(hulls_met(h));
  return {met, met & bits((begin_of(h) <= to) & (from <= end_of(h)))};
}

// Calls accept(hit) for the places where the ray meets the curve from v = a to b.
template <class F>
inline void meet_between(const CurveSeen& c, const Frame& frame, bool flat, double a, double b,
                         F&& accept) {
  constexpr u32 kDeepest = 10;
  const DVec3 axis[2] = {to_double(frame.x), to_double(frame.y)};
  u32 depth = 0, index = 0;
  for (;;) {
    const double size = (b - a) / static_cast<double>(1u << depth);
    CurvePiece piece;
    piece.a = a + index * size;
    piece.b = piece.a + size;
    piece_of(c.way, piece.a, piece.b, piece.point);
    piece_of(c.width, piece.a, piece.b, piece.radius);
    look_at(piece, flat);
    const DVec3(&p)[4] = piece.point;
    double extent = 0.0;
    for (int k = 0; k < 4; ++k) extent += abs(p[k].x) + abs(p[k].y) + abs(p[k].z);
    // The frame is orthonormal to 1e-6.
    const double reach = piece.widest * (1.0 + 1e-5) + 1e-6 * extent;
    bool near = true;  // the whole, by pieces_met
    for (u32 i = 0; i < 2 && depth > 0; ++i) {
      double low = dot(p[0], axis[i]), high = low;
      for (int k = 1; k < 4; ++k) {
        const double q = dot(p[k], axis[i]);
        low = q < low ? q : low;
        high = q > high ? q : high;
      }
      near = near && low <= reach && high >= -reach;
    }
    if (near) {
      const bool straight = piece.bend <= kCurveStraight * piece.room || depth == kDeepest;
      const bool done = straight && meet_piece(c, flat, piece, accept) != PieceMet::astray;
      if (!done && depth < kDeepest) {
        ++depth;
        index *= 2;
        continue;
      }
    }
    // On to the next piece, of the largest size that begins there.
    ++index;
    while (depth > 0 && (index & 1u) == 0) {
      index >>= 1;
      --depth;
    }
    if (depth == 0) return;
  }
}

// Calls accept(hit), as above, for every place where the ray meets the curve between two distances,
// and maybe others, some of them twice. How a place is found does not depend on the distances, or
// whoever asks within others would find another one, or none.
template <class F>
inline void meet(const Curve& curve, Vec3 origin, Vec3 direction, double nearest, double farthest,
                 F&& accept) {
  const CurveSeen c = seen_along(curve, origin, direction);
  const bool flat = (curve.flags & kCurveFlat) != 0;
  const CurvePiece all_of_it = whole(c, flat);
  if (!flat) {
    if ((curve.flags & kCurveCapStart) != 0) meet_cap(c, false, accept);
    if ((curve.flags & kCurveCapEnd) != 0) meet_cap(c, true, accept);
  }
  if (all_of_it.bend <= kCurveStraightAsWhole * all_of_it.room &&
      meet_piece(c, flat, all_of_it, accept) == PieceMet::surely) {
    return;
  }
  const Frame frame = frame_around(direction);
  const PiecesMet pieces = pieces_met(c, frame, all_of_it.bend, nearest, farthest);
  // Pieces that follow each other go together.
  for (u32 left = pieces.met; left != 0;) {
    const u32 first = lowest_bit(left), end = first + lowest_bit(~(left >> first));
    const u32 run = (1u << end) - (1u << first);
    if ((pieces.within & run) != 0) {
      meet_between(c, frame, flat, first / 16.0, end / 16.0, accept);
    }
    left &= ~run;
  }
}

// The nearest hit at 0 < t <= limit. self: the ray starts on this segment. A place that it starts
// on then is an exit of a ray that sets off outwards, and an entry of one that sets off inwards:
// what counts is an entry or an exit, respectively. A ribbon is not met again.
inline bool nearest(const Curve& c, const Ray& ray, float limit, bool self, float& distance) {
  if (self && (c.flags & kCurveFlat)) return false;
  bool found = false;
  distance = limit;
  meet(c, ray.origin, ray.direction, 0.0, limit, [&](const CurveHit& hit) {
    const float t = static_cast<float>(hit.t);
    if (!(t > 0.0f) || !(t <= distance) || (self && hit.leaving != ray.inward)) return false;
    distance = t;
    found = true;
    return true;
  });
  return found;
}

// found(lane, t) for each of the block's segments that is hit at 0 < t <= limit; it returns the
// limit for those that are left, of which the nearest hull comes first. self_lane: the lane that
// the ray starts on, or kNone.
template <class Found>
PH_INLINE void intersect(const CurveBlock& block, const Ray& ray, float limit, u32 self_lane,
                         Found&& found) {
  const Frame frame = frame_around(ray.direction);
  const LaneVec3 origin = all(ray.origin), d = all(ray.direction);
  const LaneVec3 axis_x = all(frame.x), axis_y = all(frame.y);
  HullsSeen<4> h;
  Lanes size = all(0.0f), widest = size;
  for (int k = 0; k < 4; ++k) {
    const LaneVec3 f = load(block.point[k]) - origin;
    h.x[k] = dot(f, axis_x);
    h.y[k] = dot(f, axis_y);
    h.z[k] = dot(f, d);
    size = max(dot(f, f), size);
    widest = max(load(block.radius[k]), widest);
  }
  // Rounding moves a control point by less than 16 kRounding times its distance, and what is held
  // against lines by less than 8 more.
  h.reach = widest * all(1.0f + 16.0f * kRounding) + sqrt(size) * all(24.0f * kRounding);
  const Lanes begin = begin_of(h);
  u32 left = bits(hulls_met(h) & (begin <= all(limit)) & (all(0.0f) <= end_of(h)));
  float begins[kLanes];
  store(begins, begin);
  while (left != 0) {
    u32 lane = lowest_bit(left);
    for_each_bit(left & (left - 1), [&](u32 k) { lane = begins[k] < begins[lane] ? k : lane; });
    left &= ~(1u << lane);
    float t;
    if (nearest(primitive(block, lane), ray, limit, lane == self_lane, t)) {
      limit = found(lane, t);
      if (!(limit > 0.0f)) return;
      left &= bits(begin <= all(limit));
    }
  }
}

// Where along the curve a place on its surface belongs to, at distance t from c.start along the
// ray: spheres around all other places of the curve are farther from it. Mostly within a hundredth,
// at the ends within 1/32; of curves that come near themselves it may be elsewhere.
inline double nearest_along(const CurveSeen& c, bool flat, double t) {
  alignas(64) static constexpr float kMiddles[16] = {
      0.5f / 16, 1.5f / 16, 2.5f / 16,  3.5f / 16,  4.5f / 16,  5.5f / 16,  6.5f / 16,  7.5f / 16,
      8.5f / 16, 9.5f / 16, 10.5f / 16, 11.5f / 16, 12.5f / 16, 13.5f / 16, 14.5f / 16, 15.5f / 16};
  const Lanes v = load(kMiddles);
  const auto along = [&](double c0, double c1, double c2, double c3) {
    const auto of = [](double x) { return all(static_cast<float>(x)); };
    return of(c0) + (of(c1) + (of(c2) + of(c3) * v) * v) * v;
  };
  const DVec3 place = c.direction * t;
  const DVec3(&p)[4] = c.way.of;
  const double (&r)[4] = c.width.of;
  const Lanes x = along(p[0].x - place.x, p[1].x, p[2].x, p[3].x);
  const Lanes y = along(p[0].y - place.y, p[1].y, p[2].y, p[3].y);
  const Lanes z = along(p[0].z - place.z, p[1].z, p[2].z, p[3].z);
  Lanes far = x * x + y * y + z * z;
  if (!flat) {
    const Lanes radius = along(r[0], r[1], r[2], r[3]);
    far = far - radius * radius;
  }
  float of[16];
  store(of, far);
  int near = 0;
  for (int k = 1; k < 16; ++k) near = of[k] < of[near] ? k : near;
  float shift = 0.5f;
  if (near > 0 && near < 15) {  // by a parabola through it and its neighbours
    const float before = of[near - 1] - of[near], after = of[near + 1] - of[near];
    if (before + after > 0.0f) shift += 0.5f * (before - after) / (before + after);
  }
  return (static_cast<float>(near) + shift) / 16.0f;
}

// A distance in float tells a place to half of this share of it.
inline constexpr double kCurveUnit = 0x1p-23;

// Where a ray meets the curve at distance t, straight from that; false where it may be another
// place as well, or an end. Off by a thousandth of the radius will do: in instances t is rounded as
// distances from farther away are.
inline bool met_at(const CurveSeen& c, bool flat, float t, CurveHit& hit) {
  double at = t - c.start, v = nearest_along(c, flat, at);
  if (!(flat ? refine_flat(c, at, v) : refine_round(c, at, v))) return false;
  const double half = 0.5 * kCurveUnit * t, little = 1e-3 * c.width.at(v);
  const double room = half > little ? half : little;
  if (!(v >= 0.0 && v <= 1.0 && abs(at + c.start - t) <= room)) return false;
  // From there back to where it entered a straight tube at least.
  const double back = flat ? 0.0 : 2.0 * dot(c.direction * at - c.way.at(v), c.direction);
  hit = {at + c.start, v, back > 0.0};
  return back <= 0.0 || back > 32.0 * room;
}

// The same of all places where it meets the curve.
inline CurveHit nearest_met(const Curve& c, const Ray& ray, float t) {
  const double unit = t * kCurveUnit;
  CurveHit best = {t, 0.5, false};
  double off = static_cast<double>(kInfinity);
  meet(c, ray.origin, ray.direction, t, t, [&](const CurveHit& hit) {
    // Of two that are nearer to each other than t tells, the one first met.
    const double apart = abs(hit.t - t) + (hit.leaving ? unit : 0.0);
    if (apart < off) off = apart, best = hit;
    return apart <= 0.5 * unit;
  });
  return best;
}

// Where a ray meets the surface at distance t. The parameter is (the share of a ribbon's width, v).
// The true surface of a ribbon is the tube that it stands for, up to its radius away.
inline void surface(const Curve& c, const Ray& ray, float t, SurfacePoint& out) {
  const CurveSeen s = seen_along(c, ray.origin, ray.direction);
  CurveHit hit;
  if (!met_at(s, (c.flags & kCurveFlat) != 0, t, hit)) hit = nearest_met(c, ray, t);
  const CurveJet j = jet(s, hit.v);
  const DVec3 d = s.direction, from_axis = d * (hit.t - s.start) - j.p;
  if (c.flags & kCurveFlat) {
    const DVec3 tangent = normalize(j.p1);
    const DVec3 normal = normalize(tangent * dot(d, tangent) - d);
    const double across = clamp(dot(from_axis, cross(tangent, normal)), -j.r, j.r);
    const DVec3 place = j.p + cross(tangent, normal) * across + d * s.start;
    out.point = to_float(to_double(ray.origin) + place);
    out.normal = to_float(normal);
    out.parameter = {static_cast<float>(0.5 + 0.5 * across / j.r), static_cast<float>(hit.v)};
    out.error = static_cast<float>(j.r);
    return;
  }
  const DVec3 normal = normalize(from_axis);
  out.point = to_float(to_double(ray.origin) + d * s.start + j.p + normal * j.r);
  out.normal = to_float(normal);
  out.parameter = {0.0f, static_cast<float>(hit.v)};
  out.error = 0.0f;
}

// v goes along the strand. u goes around a tube, from a place that depends on the tangent alone, or
// across a ribbon.
inline void parametrise(const Curve& c, const SurfacePoint& at, Vec2& uv, Vec3& dpdu, Vec3& dpdv) {
  const CurveJet j = jet(seen_along(c, at.point, at.normal), at.parameter.y);
  const Vec3 along = to_float(j.p1), tangent = normalize(along);
  const float span = c.along[1] - c.along[0], r = static_cast<float>(j.r);
  const Vec3 around = cross(tangent, at.normal);
  uv.y = c.along[0] + span * at.parameter.y;
  dpdv = along * (1.0f / span);
  if (c.flags & kCurveFlat) {
    uv.x = at.parameter.x;
    dpdu = around * (2.0f * r);
  } else {
    const Frame f = frame_around(tangent);
    uv.x = turn(dot(at.normal, f.y), dot(at.normal, f.x));
    dpdu = around * (2.0f * kPi * r);
  }
}

// To 1 % or so, by eight places: it weighs lights and is no part of a density.
inline float area(const Curve& c) {
  const CurveSeen s = seen_along(c, c.point[0], {0, 0, 1});
  double sum = 0.0;
  for (int i = 0; i < 8; ++i) {
    const CurveJet j = jet(s, (i + 0.5) / 8.0);
    sum += j.r * length(j.p1) / 8.0;
  }
  if (c.flags & kCurveFlat) return static_cast<float>(2.0 * sum);
  const float r0 = c.flags & kCurveCapStart ? c.radius[0] : 0.0f;
  const float r1 = c.flags & kCurveCapEnd ? c.radius[3] : 0.0f;
  return 2.0f * kPi * (static_cast<float>(sum) + r0 * r0 + r1 * r1);
}

// Directions towards a curve are those to a sphere around it; some miss it. From within that sphere
// there are none: then a curve's light is found by scattering alone.
PH_INLINE Sphere sphere_around(const Curve& c) {
  const Vec3 center = ((c.point[0] + c.point[3]) + (c.point[1] + c.point[2])) * 0.25f;
  float far = 0.0f;
  for (const Vec3& p : c.point) far = max(far, length(p - center));
  return {center, (far + widest(c)) * (1.0f + 16.0f * kRounding)};
}

PH_INLINE float pdf_towards(const Curve& c, Vec3 from, Vec3, float, Vec3) {
  return cone_pdf(sphere_around(c), from);
}

inline TowardsSample sample_towards(const Curve& c, Vec3 from, Vec2 u) {
  TowardsSample s = sample_towards(sphere_around(c), from, u);
  const Ray ray = {from, s.direction, kNoSlot, false};
  if (!(s.pdf > 0.0f) || !nearest(c, ray, kInfinity, false, s.distance)) return kNowhere;
  SurfacePoint at;
  surface(c, ray, s.distance, at);
  s.normal = at.normal;
  s.parameter = at.parameter;
  return s;
}

}  // namespace parhelion::PH_ISA
