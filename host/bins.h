// Parts of primitives, divided in two by the best of some planes across each axis.
// Method: I. Wald, "On fast Construction of SAH-based Bounding Volume Hierarchies", IEEE Symposium
// on Interactive Ray Tracing 2007.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>
#include <vector>

#include "../core/compiler.h"
#include "partition.h"
#include "sah.h"

namespace parhelion::tree {

// Of few primitives half as many bins tell as much.
inline constexpr size_t kBins = 16, kFewForBins = 64;
// Parts of fewer primitives are divided by bins, which are finer than grids.
inline constexpr size_t kGridSize = 2048;

struct Part {
  Ref* refs;
  size_t size;
  Extent box, centers;

  void grow(const Part& p) {
    box.grow(p.box);
    centers.grow(p.centers);
  }
  bool is_point() const {
    float extent[4];
    (centers.high - centers.low).store(extent);
    return extent[0] == 0.0f && extent[1] == 0.0f && extent[2] == 0.0f;
  }
};

inline Part measure(Ref* refs, size_t n) {
  Part p{refs, n, {}, {}};
  for (size_t i = 0; i < n; ++i) {
    p.box.grow(refs[i]);
    p.centers.grow(center_of(refs[i]));
  }
  return p;
}

// The same of n primitives, of which ref_of(i) is the ith, but for where they are; by `Share`, one
// of the ways to share work out (tasks.h).
template <class Share, class RefOf>
Part measure_by(size_t n, const RefOf& ref_of) {
  constexpr size_t kLeast = 4096;  // for a thread
  const size_t chunks = std::clamp(n / kLeast, size_t{1}, static_cast<size_t>(Share::threads()));
  std::vector<Part> parts(chunks);
  Share()(chunks, [&](size_t t) {
    Part mine{};
    for (size_t i = n * t / chunks, end = n * (t + 1) / chunks; i < end; ++i) {
      const Ref& r = ref_of(i);
      mine.box.grow(r);
      mine.centers.grow(center_of(r));
    }
    parts[t] = mine;
  });
  Part all{nullptr, n, {}, {}};
  for (const Part& p : parts) all.grow(p);
  return all;
}

// A plane across an axis that divides a part by where centres lie; none where axis < 0.
struct Plane {
  int axis = -1;
  float low = 0.0f, scale = 0.0f;
  int last = 0, bin = 0;
  size_t count = 0;       // of those before it
  float cost = INFINITY;  // expected

  bool before(const Ref& r) const {
    return std::min(last, static_cast<int>((center_of(r, axis) - low) * scale)) < bin;
  }
};

// Bins of equal width along each axis of where centres lie.
template <size_t kCount>
struct Bins {
  float low[4], scale[4] = {};
  Bin bins[3][kCount];

  explicit Bins(const Extent& centers) {
    float extent[4];
    centers.low.store(low);
    (centers.high - centers.low).store(extent);
    for (int k = 0; k < 3; ++k) {
      scale[k] = extent[k] > 0.0f ? kCount * (1.0f - 1e-6f) / extent[k] : 0.0f;
      if (!std::isfinite(scale[k])) scale[k] = 0.0f;
    }
  }

  void fill(const Ref* refs, size_t n) {
    const Point base = Point::of(low), factor = Point::of(scale),
                last = Point::all(static_cast<float>(kCount - 1));
    for_some(n, [&](size_t first, size_t count) {
      const Ref* const some = refs + first;
      int at[kSome][4];
      for (size_t i = 0; i < count; ++i) {
        min((center_of(some[i]) - base) * factor, last).truncate(at[i]);
      }
      for (size_t i = 0; i < count; ++i) {
        for (int k = 0; k < 3; ++k) bins[k][at[i][k]].add(some[i]);
      }
    });
  }

  // The plane of the least expected cost between them.
  Plane best() const {
    Plane best;
    for (int k = 0; k < 3; ++k) {
      size_t cut = 0;
      if (scale[k] == 0.0f) continue;
      const float c = best_of(bins[k], kCount, cut);
      if (c < best.cost) {
        best = {k, low[k], scale[k], static_cast<int>(kCount) - 1, static_cast<int>(cut), 0, c};
      }
    }
    for (int b = 0; b < best.bin; ++b) best.count += bins[best.axis][b].count;
    return best;
  }
};

// Apart, or all forks above one would keep room for bins.
template <size_t kCount>
PH_APART inline Plane best_plane(const Part& p) {
  Bins<kCount> bins(p.centers);
  bins.fill(p.refs, p.size);
  return bins.best();
}

// By the middle one along the widest axis.
inline void split_by_count(const Part& p, Part& left, Part& right) {
  float extent[4];
  (p.centers.high - p.centers.low).store(extent);
  int axis = 0;
  for (int k = 1; k < 3; ++k) {
    if (extent[k] > extent[axis]) axis = k;
  }
  const size_t cut = p.size / 2;
  std::nth_element(p.refs, p.refs + cut, p.refs + p.size, [axis](const Ref& a, const Ref& b) {
    return center_of(a, axis) < center_of(b, axis) ||
           (center_of(a, axis) == center_of(b, axis) && a.id < b.id);
  });
  left = measure(p.refs, cut);
  right = measure(p.refs + cut, p.size - cut);
}

// Brings those of a half, fewer than a leaf holds, that lie next to the cut to its side: the last
// ones along an axis to the end of a left half, the first ones to the beginning of a right one.
inline void bring_to_cut(const Part& half, bool left, int axis, size_t count) {
  struct Near {
    float along;  // more is nearer
    Ref* at;
  };
  Near found[kLeafSize];  // the nearest first
  size_t n = 0;
  for (Ref* r = half.refs; r != half.refs + half.size; ++r) {
    const float center = center_of(*r, axis);
    const Near near = {left ? center : -center, r};
    if (n == count && !(near.along > found[n - 1].along)) continue;  // nearly all
    size_t i = n < count ? n++ : n - 1;
    for (; i > 0 && near.along > found[i - 1].along; --i) found[i] = found[i - 1];
    found[i] = near;
  }
  // So that none is where another has been brought to.
  std::sort(found, found + n,
            [&](const Near& a, const Near& b) { return left ? a.at > b.at : a.at < b.at; });
  Ref* const first = left ? half.refs + half.size - 1 : half.refs;
  for (size_t i = 0; i < n; ++i) std::swap(*found[i].at, left ? *(first - i) : first[i]);
}

// Moves the cut to where one block fewer is needed, unless that costs more; primitives whose
// centres are one stay together.
inline void fill_leaves(const Part& p, int axis, Part& left, Part& right) {
  const auto blocks = [](size_t n) { return (n + kLeafSize - 1) / kLeafSize; };
  if (p.size > kGridSize || blocks(left.size) + blocks(right.size) == blocks(p.size)) return;
  const size_t below = left.size / kLeafSize * kLeafSize;
  const size_t over = p.size - right.size / kLeafSize * kLeafSize;
  size_t cut = left.size - below < over - left.size ? below : over;
  if (cut == 0) cut = over;
  if (cut == p.size) cut = below;
  if (cut == 0 || cut == p.size) return;
  Part full_left = left, full_right = right;
  if (cut < left.size) {
    bring_to_cut(left, true, axis, left.size - cut);
    full_left = measure(p.refs, cut);
    full_right.grow(measure(p.refs + cut, left.size - cut));
  } else {
    bring_to_cut(right, false, axis, cut - left.size);
    full_left.grow(measure(right.refs, cut - left.size));
    full_right = measure(p.refs + cut, p.size - cut);
  }
  full_left.size = cut;
  full_right.refs = p.refs + cut;
  full_right.size = p.size - cut;
  float high[4], low[4];
  full_left.centers.high.store(high);
  full_right.centers.low.store(low);
  if (high[axis] < low[axis] &&
      cost(full_left.box, full_left.size) + cost(full_right.box, full_right.size) <=
          cost(left.box, left.size) + cost(right.box, right.size)) {
    left = full_left;
    right = full_right;
  }
}

// Apart, as partition() keeps room, too.
PH_APART inline void split(const Part& p, const Plane& plane, Part& left, Part& right) {
  partition(p.refs, p.refs + plane.count, p.refs + p.size,
            [&](const Ref& r) { return plane.before(r); });
  left = measure(p.refs, plane.count);
  right = measure(p.refs + plane.count, p.size - plane.count);
}

// Divides a part in two of the least expected cost; by the middle one where centres coincide.
inline void split(const Part& p, Part& left, Part& right) {
  const Plane plane = p.size > kFewForBins ? best_plane<kBins>(p) : best_plane<kBins / 2>(p);
  if (plane.axis < 0) {
    split_by_count(p, left, right);
    return;
  }
  split(p, plane, left, right);
  fill_leaves(p, plane.axis, left, right);
}

}  // namespace parhelion::tree
