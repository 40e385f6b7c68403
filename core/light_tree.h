// Which of many lights to ask, in time that grows with the logarithm of their number: a tree of
// clusters, each with bounds on where its lights lie and where they shine, descended by choosing a
// child in proportion to what it may at most send to the point.
// Method: A. Conty Estevez and C. Kulla, "Importance Sampling of Many Lights with Adaptive Tree
// Splitting", PACMCGIT 1(2), 2018; the importance in cosines, without angles: M. Pharr, W. Jakob
// and G. Humphreys, "Physically Based Rendering", 4th edition, section 12.6.3. Ours has sixteen
// children a node, all weighed at once.
//
// What a surface mirrors it does not scatter alike to everywhere: a point may come with a
// highlight, by which clusters are weighed, too.
//
// A cluster is a sphere around its lights; `axis` and cos_o bound their normals, and cos_e how far
// from its normal a light shines. Angles are handled as cosine and sine. Lights on the horizon of
// the receiver, or that see it on theirs, keep a small importance: rounding must not lose one that
// does contribute. Where every child of a chosen cluster is dark no light is chosen.
#pragma once
#include "rows.h"
#include "simd.h"

namespace parhelion {

// Bit set in a child: it is a light. Else it is another node.
inline constexpr u32 kLightBit = 1u << 31;
// Levels of nodes at most; the builder keeps to it.
inline constexpr int kMaxLightDepth = 16;

// Sixteen clusters or lights. Lengths in normalised units; power as a share of the scene's, 0 in
// unused lanes.
struct alignas(64) LightNode {
  float x[16], y[16], z[16], radius[16];
  float axis_x[16], axis_y[16], axis_z[16], cos_o[16], cos_e[16];
  float power[16];
  u32 child[16];
};

// A slot is a place in the tree: the node's index times sixteen plus the lane.
struct LightTreeView {
  const LightNode* nodes;   // the root first
  const u32* slot_of_node;  // where it hangs; kNone for the root
  const u32* slot_of_light;
  u32 light_count;
};

struct LightChoice {
  u32 light;  // kNone if no light can reach the point
  float probability;
  float u;  // a new uniform number, independent of the choice
};

}  // namespace parhelion

namespace parhelion::PH_ISA {

// Where light is asked for: the point, and the side of the surface that counts, or 0 for any.
struct Receiver {
  Vec3 point, normal;
};
// And how: of what the surface scatters `gloss` is the share, in 0 to 1, that falls off around a
// direction, as what microfacets mirror does whose alpha^2 is the inverse of `tightness`.
struct Highlight {
  Vec3 direction;
  float gloss, tightness;
};
inline constexpr Highlight kNoHighlight = {{0, 0, 0}, 0.0f, 0.0f};

// Cosines this far beyond a bound still count. Cosines near 1 and their sines, kept in float, place
// an angle no better than sqrt(2^-23) = 3.5e-4.
inline constexpr float kConeSlack = 1e-3f;
// Floor of a squared distance, so that its inverse is finite; far below what tells points apart.
inline constexpr float kNearest2 = 1e-36f;

struct LaneAngle {
  Lanes c, s;
};

// a - b, or 0 where b is larger; both within [0, pi].
PH_INLINE LaneAngle shrink(const LaneAngle& a, const LaneAngle& b) {
  const LaneMask within = b.c < a.c;
  const Lanes zero = all(0.0f);
  return {select(within, all(1.0f), a.c * b.c + a.s * b.s),
          select(within, zero, max(a.s * b.c - a.c * b.s, zero))};
}

PH_INLINE LaneAngle angle_of(const Lanes& cosine) {
  return {cosine, sqrt(max(all(1.0f) - cosine * cosine, all(0.0f)))};
}

// Sixteen pairs of a cluster and a point that is lit.
struct LightPairs {
  Lanes dx, dy, dz;  // from the point to the cluster's centre
  Lanes radius, axis_x, axis_y, axis_z, cos_o, cos_e, power;
};

// What the cluster may send to the point, before the surface there is asked; `inverse` is that of
// the distance, and `half` half the angle that the cluster takes in the point's view.
PH_INLINE Lanes light_leaving(const LightPairs& p, Lanes& inverse, LaneAngle& half) {
  const Lanes zero = all(0.0f), slack = all(kConeSlack);
  const Lanes distance2 = max(p.dx * p.dx + p.dy * p.dy + p.dz * p.dz, all(kNearest2));
  inverse = all(1.0f) / sqrt(distance2);
  const Lanes radius2 = p.radius * p.radius;

  // From within, every direction.
  const LaneMask outside = radius2 < distance2;
  const Lanes sine = select(outside, p.radius * inverse, zero);
  half = {select(outside, sqrt(max(all(1.0f) - sine * sine, zero)), all(-1.0f)), sine};

  // The least angle at which any of the cluster's lights is seen from its front.
  const Lanes toward = (zero - (p.axis_x * p.dx + p.axis_y * p.dy + p.axis_z * p.dz)) * inverse;
  const LaneAngle w = angle_of(max(all(-1.0f), min(toward, all(1.0f))));
  const Lanes leaving = shrink(shrink(w, angle_of(p.cos_o)), half).c;
  const Lanes value = p.power * max(leaving, slack) / max(distance2, radius2);
  return select(p.cos_e - slack <= leaving, value, zero);
}

// That from the side of a surface that its normal points to.
PH_INLINE Lanes light_arriving(const LightPairs& p, const Lanes& value, const Lanes& inverse,
                               const LaneAngle& half, const Lanes& nx, const Lanes& ny,
                               const Lanes& nz) {
  const Lanes zero = all(0.0f), slack = all(kConeSlack);
  const Lanes facing = (nx * p.dx + ny * p.dy + nz * p.dz) * inverse;
  const LaneAngle i = angle_of(max(all(-1.0f), min(facing, all(1.0f))));
  const Lanes arriving = shrink(i, half).c;
  return select(zero - slack <= arriving, value * max(arriving, slack), zero);
}

// What a receiver's highlight leaves of it: at most that of GGX's microfacets, whose normals lie
// half as far from the surface's as the light from the highlight's direction.
PH_INLINE Lanes light_in_highlight(const LightPairs& p, const Lanes& inverse, const LaneAngle& half,
                                   const Lanes& x, const Lanes& y, const Lanes& z,
                                   const Lanes& gloss, const Lanes& tightness) {
  const Lanes one = all(1.0f);
  const Lanes along = (x * p.dx + y * p.dy + z * p.dz) * inverse;
  const Lanes c = min(shrink(angle_of(max(all(-1.0f), min(along, one))), half).c, one);
  const Lanes fall = all(0.5f) * ((one + c) + (one - c) * tightness);
  return (one - gloss) + gloss / (fall * fall);
}

PH_INLINE float sum_of(const float (&weight)[16]) {
  float sum = 0.0f;
  for (int k = 0; k < 16; ++k) sum = sum + weight[k];
  return sum;
}

// What each child of a node may send to a point. With a normal, only from its side of the surface;
// with none (0, 0, 0), as in a medium or where light passes through, from anywhere. Returns the
// sum.
PH_INLINE float light_weights(const LightNode& node, const Receiver& at, const Highlight& highlight,
                              float (&weight)[16]) {
  const Vec3 from = at.point, normal = at.normal;
  const LightPairs p = {load(node.x) - all(from.x), load(node.y) - all(from.y),
                        load(node.z) - all(from.z), load(node.radius),
                        load(node.axis_x),          load(node.axis_y),
                        load(node.axis_z),          load(node.cos_o),
                        load(node.cos_e),           load(node.power)};
  Lanes inverse;
  LaneAngle half;
  Lanes value = light_leaving(p, inverse, half);
  if (!black(normal)) {
    value = light_arriving(p, value, inverse, half, all(normal.x), all(normal.y), all(normal.z));
  }
  if (highlight.gloss != 0.0f) {
    const Vec3 d = highlight.direction;
    value = value * light_in_highlight(p, inverse, half, all(d.x), all(d.y), all(d.z),
                                       all(highlight.gloss), all(highlight.tightness));
  }
  store(weight, value);
  return sum_of(weight);
}

// Chooses one of sixteen children by weights whose sum is not 0; `rest` is a uniform number and
// becomes a new one.
PH_INLINE u32 choose_lane(const float* weight, float sum, double& rest) {
  // The last lane that has a weight takes what rounding leaves over.
  const double target = rest * static_cast<double>(sum);
  double before = 0.0, at = 0.0;
  u32 lane = 0;
  for (u32 k = 0; k < 16; ++k) {
    if (weight[k] == 0.0f) continue;
    lane = k;
    at = before;
    before += static_cast<double>(weight[k]);
    if (target < before) break;
  }
  rest = (target - at) / static_cast<double>(weight[lane]);
  rest = rest < 1.0 ? rest : 1.0 - 0x1p-53;
  return lane;
}

// The number that chooses a light; what is left of it is the first of the two that place a point on
// the light. So points spread as evenly over a lamp of two triangles as over one: if the choice had
// a number of its own, either triangle would get a random part of them. The upper 24 of its 48 bits
// are `point`, which samples spread; the lower ones are a number that has nothing else to do.
PH_INLINE double light_number(float point, float lower) {
  return static_cast<double>(point) + static_cast<double>(lower) * 0x1p-24;
}

// What is left of a number in [0, 1) that has made its choices.
PH_INLINE float unused(double rest) { return min(static_cast<float>(rest), kBelowOne); }

// Chooses a light by a number of 48 bits: among a million lights a choice uses 20, and what is left
// of 24 could no longer tell neighbours' probabilities apart, let alone be used again.
inline LightChoice choose_light(const LightTreeView& tree, const Receiver& at,
                                const Highlight& highlight, double u) {
  const LightChoice nothing = {kNone, 0.0f, 0.0f};
  if (tree.light_count == 0) return nothing;
  double rest = u;
  float share[kMaxLightDepth];
  int depth = 0;
  u32 index = 0;
  for (;;) {
    const LightNode& node = tree.nodes[index];
    float weight[16];
    const float sum = light_weights(node, at, highlight, weight);
    if (!(sum > 0.0f)) return nothing;
    const u32 lane = choose_lane(weight, sum, rest);
    share[depth++] = weight[lane] / sum;
    const u32 child = node.child[lane];
    if (child & kLightBit) {
      float probability = 1.0f;
      while (depth > 0) probability *= share[--depth];
      return {child & ~kLightBit, probability, unused(rest)};
    }
    index = child;
  }
}

// What choose_light takes for each of sixteen points where all lights are children of the root, for
// all at once, to the same bits. glossy: whether any has a highlight. Of none the light is kNone.
inline void choose_lights(const LightTreeView& tree, const Rows<Receiver, 16>& at,
                          const Rows<Highlight, 16>& highlight, bool glossy,
                          const double (&number)[16], u32 (&light)[16], float (&probability)[16],
                          float (&u)[16]) {
  const LightNode& node = tree.nodes[0];
  const auto row = [&](u32 k) { return load(highlight.row[k]); };
  const Lanes x = load(at.row[0]), y = load(at.row[1]), z = load(at.row[2]), zero = all(0.0f);
  const Lanes nx = load(at.row[3]), ny = load(at.row[4]), nz = load(at.row[5]);
  const LaneMask sided = zero < nx * nx + ny * ny + nz * nz;
  float weight[16][16];  // by child and point
  Lanes sum = zero;
  for (u32 k = 0; k < 16; ++k) {
    if (!(node.power[k] > 0.0f)) continue;
    const LightPairs p = {all(node.x[k]) - x,  all(node.y[k]) - y,  all(node.z[k]) - z,
                          all(node.radius[k]), all(node.axis_x[k]), all(node.axis_y[k]),
                          all(node.axis_z[k]), all(node.cos_o[k]),  all(node.cos_e[k]),
                          all(node.power[k])};
    Lanes inverse;
    LaneAngle half;
    const Lanes leaving = light_leaving(p, inverse, half);
    Lanes value = select(sided, light_arriving(p, leaving, inverse, half, nx, ny, nz), leaving);
    if (glossy) {
      value = value * light_in_highlight(p, inverse, half, row(0), row(1), row(2), row(3), row(4));
    }
    store(weight[k], value);
    sum = sum + value;
  }
  float sums[16], share[16] = {};
  store(sums, sum);
  double target[16], start[16] = {}, before[16] = {};
  for (u32 i = 0; i < 16; ++i) {
    target[i] = number[i] * static_cast<double>(sums[i]);
    light[i] = kNone;
  }
  for (u32 k = 0; k < 16; ++k) {
    if (!(node.power[k] > 0.0f)) continue;
    const u32 child = node.child[k] & ~kLightBit;
    for (u32 i = 0; i < 16; ++i) {
      const bool taken = target[i] >= before[i] && weight[k][i] != 0.0f;
      light[i] = taken ? child : light[i];
      share[i] = taken ? weight[k][i] : share[i];
      start[i] = taken ? before[i] : start[i];
      before[i] += static_cast<double>(weight[k][i]);
    }
  }
  for (u32 i = 0; i < 16; ++i) {
    probability[i] = share[i] / sums[i];
    u[i] = unused((target[i] - start[i]) / static_cast<double>(share[i]));
  }
}

// The probability with which choose_light takes a light: the same bits, being the same product
// taken in the same order, from the light up.
inline float light_probability(const LightTreeView& tree, u32 light, const Receiver& at,
                               const Highlight& highlight) {
  float probability = 1.0f;
  for (u32 slot = tree.slot_of_light[light]; slot != kNone; slot = tree.slot_of_node[slot >> 4]) {
    float weight[16];
    const float sum = light_weights(tree.nodes[slot >> 4], at, highlight, weight);
    const float w = weight[slot & 15u];
    if (!(w > 0.0f)) return 0.0f;
    probability *= w / sum;
  }
  return probability;
}

}  // namespace parhelion::PH_ISA
