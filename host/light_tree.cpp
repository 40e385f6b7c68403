#include "light_tree.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>

#include "../core/special.h"
#include "memory.h"
#include "threads.h"

namespace parhelion {
namespace {

using baseline::dot;
using baseline::operator+;
using baseline::operator-;
using baseline::operator*;

constexpr size_t kNodeSize = 16;
constexpr double kUsualNode = 10.0;  // lights in a lowest node, aimed at
constexpr int kBins = 16;
// Below this many lights a subtree is one thread's job.
constexpr size_t kJobSize = 4096;
// Sums are taken chunk by chunk and the chunks added in order, whoever computed them.
constexpr size_t kChunk = 1u << 16;
// Below this depth parts are split by count. Eight more levels hold 2^31 lights, so kMaxLightDepth
// is kept.
constexpr int kHeuristicDepth = kMaxLightDepth - 8;
// Smaller shares of the power count as this much: the light may still be the only one in sight.
constexpr float kLeastPower = 1e-30f;

double component(Vec3 v, int axis) { return axis == 0 ? v.x : axis == 1 ? v.y : v.z; }
float center(const LightLeaf& leaf, int axis) {
  return static_cast<float>(0.5 *
                            (component(leaf.bounds.low, axis) + component(leaf.bounds.high, axis)));
}

// Sums over a set of lights. The mean direction of a cap of half angle t is (1 + cos t) / 2 long,
// so the length of the lights' mean direction says how far their normals spread without any order
// in which cones would have to be merged.
struct Summary {
  float low[3] = {INFINITY, INFINITY, INFINITY};
  float high[3] = {-INFINITY, -INFINITY, -INFINITY};
  float center_low[3] = {INFINITY, INFINITY, INFINITY};
  float center_high[3] = {-INFINITY, -INFINITY, -INFINITY};
  double direction[3] = {0, 0, 0};  // sum of power times mean direction
  double power = 0;
  float cos_e = 1.0f;
  size_t count = 0;

  void add(const LightLeaf& leaf) {
    const double share = static_cast<double>(leaf.power) * 0.5 * (1.0 + leaf.cos_o);
    for (int k = 0; k < 3; ++k) {
      low[k] = std::min(low[k], static_cast<float>(component(leaf.bounds.low, k)));
      high[k] = std::max(high[k], static_cast<float>(component(leaf.bounds.high, k)));
      center_low[k] = std::min(center_low[k], center(leaf, k));
      center_high[k] = std::max(center_high[k], center(leaf, k));
      direction[k] += share * component(leaf.axis, k);
    }
    power += leaf.power;
    cos_e = std::min(cos_e, leaf.cos_e);
    ++count;
  }
  void add(const Summary& b) {
    for (int k = 0; k < 3; ++k) {
      low[k] = std::min(low[k], b.low[k]);
      high[k] = std::max(high[k], b.high[k]);
      center_low[k] = std::min(center_low[k], b.center_low[k]);
      center_high[k] = std::max(center_high[k], b.center_high[k]);
      direction[k] += b.direction[k];
    }
    power += b.power;
    cos_e = std::min(cos_e, b.cos_e);
    count += b.count;
  }

  // Length of `direction`.
  double directed() const {
    return std::sqrt(direction[0] * direction[0] + direction[1] * direction[1] +
                     direction[2] * direction[2]);
  }

  // What a cluster costs: power times the solid angle into which it shines, weighted by the cosine
  // (Conty Estevez and Kulla, section 4.4), times the squared size of the sphere that stands for it
  // in the importance. Their surface area is 0 for lights along a line.
  double cost() const {
    if (count == 0 || power <= 0.0) return 0.0;
    const float cos_o = static_cast<float>(std::clamp(2.0 * directed() / power - 1.0, -1.0, 1.0));
    const double o = baseline::acos(cos_o), e = baseline::acos(cos_e);
    const double sin_o = std::sqrt(std::max(0.0, 1.0 - static_cast<double>(cos_o) * cos_o));
    const double sin_e = std::sqrt(std::max(0.0, 1.0 - static_cast<double>(cos_e) * cos_e));
    // Up to w from the axis there is light. cos(2 w - o) is cos(o + 2 e) or cos(2 pi - o).
    const bool everywhere = o + e >= kPi;
    const double w = everywhere ? kPi : o + e;
    const double cos_turn =
        everywhere ? cos_o : cos_o * (2.0 * cos_e * cos_e - 1.0) - sin_o * 2.0 * sin_e * cos_e;
    const double angle = 2.0 * kPi * (1.0 - cos_o) +
                         0.5 * kPi * (2.0 * w * sin_o - cos_turn - 2.0 * o * sin_o + cos_o);
    double size2 = 0.0;
    for (int k = 0; k < 3; ++k) {
      const double extent = static_cast<double>(high[k]) - low[k];
      size2 += extent * extent;
    }
    return power * angle * size2;
  }
};

struct Part {
  size_t first, last;
  Summary sum;
  size_t size() const { return last - first; }
};

// One child's place in a node.
void set_lane(LightNode& node, u32 lane, Vec3 at, float radius, Vec3 axis, float cos_o, float cos_e,
              float power, u32 child) {
  node.x[lane] = at.x, node.y[lane] = at.y, node.z[lane] = at.z;
  node.radius[lane] = radius;
  node.axis_x[lane] = axis.x, node.axis_y[lane] = axis.y, node.axis_z[lane] = axis.z;
  node.cos_o[lane] = cos_o, node.cos_e[lane] = cos_e;
  node.power[lane] = power > 0.0f ? std::max(power, kLeastPower) : 0.0f;
  node.child[lane] = child;
}

class Builder {
 public:
  explicit Builder(std::vector<LightLeaf>& leaves) : leaves_(leaves) {}

  void build(LightTree& tree) {
    const Part all = measure(0, leaves_.size());
    scale_ = all.sum.power > 0.0 ? 1.0 / all.sum.power : 0.0;
    std::vector<Job> jobs;
    expand(all, 0, tree.nodes, jobs);
    std::vector<std::vector<LightNode>> parts(jobs.size());
    MemoryGuard guard;
#pragma omp parallel for schedule(dynamic, 1)
    for (size_t i = 0; i < jobs.size(); ++i) {
      guard.run([&] { subtree(jobs[i].part, jobs[i].depth, parts[i]); });
    }
    guard.check();
    join(tree, jobs, parts);
  }

 private:
  struct Job {
    Part part;
    int depth;
    u32 slot;  // the lane that it is to hang in; kNone for the root
  };

  std::vector<LightLeaf>& leaves_;
  double scale_ = 0.0;

  // Calls f(chunk, first, last) for the chunks of a range, in parallel if there are several.
  template <class F>
  static void for_chunks(size_t first, size_t last, F f) {
    const size_t chunks = (last - first + kChunk - 1) / kChunk;
    if (chunks == 1) return f(0, first, last);
#pragma omp parallel for schedule(dynamic, 1)
    for (size_t c = 0; c < chunks; ++c) {
      f(c, first + c * kChunk, std::min(last, first + (c + 1) * kChunk));
    }
  }
  static size_t chunks_of(const Part& p) { return (p.size() + kChunk - 1) / kChunk; }

  Part measure(size_t first, size_t last) {
    Part p = {first, last, {}};
    std::vector<Summary> chunk(chunks_of(p));
    for_chunks(first, last, [&](size_t c, size_t a, size_t b) {
      for (size_t i = a; i < b; ++i) chunk[c].add(leaves_[i]);
    });
    for (const Summary& s : chunk) p.sum.add(s);
    return p;
  }

  struct Bins {
    Summary bin[3][kBins];
  };

  static int bin_of(float x, float low, float scale) {
    return std::min(kBins - 1, static_cast<int>((x - low) * scale));
  }

  void fill(const Part& p, const float (&scale)[3], Bins& bins) {
    std::vector<Bins> chunk(chunks_of(p));
    for_chunks(p.first, p.last, [&](size_t c, size_t a, size_t b) {
      for (size_t i = a; i < b; ++i) {
        for (int k = 0; k < 3; ++k) {
          if (scale[k] == 0.0f) continue;
          const float x = center(leaves_[i], k);
          chunk[c].bin[k][bin_of(x, p.sum.center_low[k], scale[k])].add(leaves_[i]);
        }
      }
    });
    for (const Bins& b : chunk) {
      for (int k = 0; k < 3; ++k) {
        for (int i = 0; i < kBins; ++i) bins.bin[k][i].add(b.bin[k][i]);
      }
    }
  }

  // Divides a part where the sum of the two costs is least.
  void split(const Part& p, bool by_count, Part& left, Part& right) {
    float scale[3];
    for (int k = 0; k < 3; ++k) {
      const float extent = p.sum.center_high[k] - p.sum.center_low[k];
      scale[k] = extent > 0.0f ? kBins * (1.0f - 1e-6f) / extent : 0.0f;
      if (!std::isfinite(scale[k])) scale[k] = 0.0f;
    }
    int best_axis = -1, best_bin = 0;
    Bins bins;
    if (!by_count) {
      fill(p, scale, bins);
      double best = std::numeric_limits<double>::infinity();
      for (int k = 0; k < 3; ++k) {
        if (scale[k] == 0.0f) continue;
        Summary after[kBins];
        for (int i = kBins - 1; i > 0; --i) {
          if (i + 1 < kBins) after[i] = after[i + 1];
          after[i].add(bins.bin[k][i]);
        }
        Summary before;
        for (int i = 1; i < kBins; ++i) {
          before.add(bins.bin[k][i - 1]);
          if (before.count == 0 || after[i].count == 0) continue;
          const double cost = before.cost() + after[i].cost();
          if (cost < best) best = cost, best_axis = k, best_bin = i;
        }
      }
    }
    if (best_axis < 0) {
      split_by_count(p, left, right);
      return;
    }
    // Written out, because where std::partition leaves things is not laid down.
    const float low = p.sum.center_low[best_axis];
    size_t cut = p.first;
    for (size_t i = p.first; i < p.last; ++i) {
      if (bin_of(center(leaves_[i], best_axis), low, scale[best_axis]) < best_bin) {
        std::swap(leaves_[i], leaves_[cut++]);
      }
    }
    left = {p.first, cut, {}};
    right = {cut, p.last, {}};
    for (int i = 0; i < kBins; ++i) {
      (i < best_bin ? left : right).sum.add(bins.bin[best_axis][i]);
    }
  }

  void split_by_count(const Part& p, Part& left, Part& right) {
    int axis = 0;
    for (int k = 1; k < 3; ++k) {
      if (p.sum.center_high[k] - p.sum.center_low[k] >
          p.sum.center_high[axis] - p.sum.center_low[axis]) {
        axis = k;
      }
    }
    const auto begin = leaves_.begin();
    std::sort(begin + static_cast<std::ptrdiff_t>(p.first),
              begin + static_cast<std::ptrdiff_t>(p.last),
              [axis](const LightLeaf& a, const LightLeaf& b) {
                const float x = center(a, axis), y = center(b, axis);
                return x < y || (x == y && a.light < b.light);
              });
    const size_t cut = p.first + p.size() / 2;
    left = measure(p.first, cut);
    right = measure(cut, p.last);
  }

  // Children for a node of n lights such that the levels below are filled evenly.
  static int fanout(size_t n) {
    const double nodes = static_cast<double>(n) / kUsualNode;
    int levels = 1;
    for (double capacity = 16.0; capacity < nodes; capacity *= 16.0) ++levels;
    int children = 2;
    for (; children < 16; ++children) {
      double reach = 1.0;
      for (int i = 0; i < levels; ++i) reach *= children;
      if (reach >= nodes) break;
    }
    return children;
  }

  // Up to sixteen parts of p: single lights where there are no more of them, else made by dividing
  // the costliest again and again.
  int children_of(const Part& p, int depth, Part (&child)[16]) {
    if (p.size() <= kNodeSize) {
      for (size_t i = 0; i < p.size(); ++i) child[i] = {p.first + i, p.first + i + 1, {}};
      return static_cast<int>(p.size());
    }
    const bool by_count = depth >= kHeuristicDepth;
    const int wanted = by_count ? 16 : fanout(p.size());
    int count = 1;
    child[0] = p;
    while (count < wanted) {
      int next = -1;
      double largest = -1.0;
      for (int i = 0; i < count; ++i) {
        const double size = by_count ? static_cast<double>(child[i].size()) : child[i].sum.cost();
        if (child[i].size() > kNodeSize && size > largest) next = i, largest = size;
      }
      if (next < 0) break;
      const Part whole = child[next];
      split(whole, by_count, child[next], child[count]);
      ++count;
    }
    return count;
  }

  // Bounds of a part's lights, taken from the lights themselves rather than from clusters of them.
  void set_cluster(LightNode& node, u32 lane, const Part& p, u32 child) {
    if (p.size() == 1) {
      const LightLeaf& l = leaves_[p.first];
      const Vec3 at = {center(l, 0), center(l, 1), center(l, 2)};
      set_lane(node, lane, at, reach(l, at), l.axis, l.cos_o, l.cos_e,
               static_cast<float>(l.power * scale_), kLightBit | l.light);
      return;
    }
    const Summary& s = p.sum;
    const auto middle = [&](int k) {
      return static_cast<float>(0.5 * (static_cast<double>(s.low[k]) + s.high[k]));
    };
    const Vec3 at = {middle(0), middle(1), middle(2)};
    const double size = s.directed();
    Vec3 axis = {0, 0, 1};
    if (size > 0.0) {
      axis = {static_cast<float>(s.direction[0] / size), static_cast<float>(s.direction[1] / size),
              static_cast<float>(s.direction[2] / size)};
    }
    struct Bound {
      float radius = 0.0f, cos_o = 1.0f;
    };
    std::vector<Bound> chunk(chunks_of(p));
    for_chunks(p.first, p.last, [&](size_t c, size_t a, size_t b) {
      for (size_t i = a; i < b; ++i) {
        chunk[c].radius = std::max(chunk[c].radius, reach(leaves_[i], at));
        chunk[c].cos_o = std::min(chunk[c].cos_o, widened(leaves_[i], axis));
      }
    });
    Bound bound;
    for (const Bound& b : chunk) {
      bound.radius = std::max(bound.radius, b.radius);
      bound.cos_o = std::min(bound.cos_o, b.cos_o);
    }
    set_lane(node, lane, at, bound.radius, axis, bound.cos_o, s.cos_e,
             static_cast<float>(s.power * scale_), child);
  }

  // Distance from a point to the far corner of a light's bounds, rounded up.
  static float reach(const LightLeaf& leaf, Vec3 at) {
    const auto far = [](float x, float low, float high) { return std::max(x - low, high - x); };
    const Vec3 d = {far(at.x, leaf.bounds.low.x, leaf.bounds.high.x),
                    far(at.y, leaf.bounds.low.y, leaf.bounds.high.y),
                    far(at.z, leaf.bounds.low.z, leaf.bounds.high.z)};
    return baseline::length(d) * (1.0f + 1e-6f);
  }

  // Cosine of the half angle around `axis` that holds all of a light's normals. The sine is taken
  // from the cross product, which is exact where the cosine nears 1.
  static float widened(const LightLeaf& leaf, Vec3 axis) {
    const Vec3 a = leaf.axis;
    const float c = dot(a, axis);
    if (c <= -leaf.cos_o) return -1.0f;
    const Vec3 cross = {a.y * axis.z - a.z * axis.y, a.z * axis.x - a.x * axis.z,
                        a.x * axis.y - a.y * axis.x};
    const float sin_leaf = baseline::safe_sqrt(1.0f - leaf.cos_o * leaf.cos_o);
    return std::clamp(c * leaf.cos_o - baseline::length(cross) * sin_leaf, -1.0f, 1.0f);
  }

  // The part of the tree above the jobs; the root is a job itself in a small tree.
  u32 expand(const Part& p, int depth, std::vector<LightNode>& top, std::vector<Job>& jobs) {
    if (depth == 0 && p.size() <= kJobSize) {
      jobs.push_back({p, depth, kNone});
      return 0;
    }
    Part child[16];
    const int count = children_of(p, depth, child);
    const u32 index = static_cast<u32>(top.size());
    top.push_back({});
    for (int i = 0; i < count; ++i) {
      const u32 lane = static_cast<u32>(i);
      set_cluster(top[index], lane, child[i], 0);
      if (child[i].size() == 1) continue;
      if (child[i].size() <= kJobSize) {
        jobs.push_back({child[i], depth + 1, index << 4 | lane});
      } else {
        const u32 c = expand(child[i], depth + 1, top, jobs);
        top[index].child[lane] = c;
      }
    }
    return index;
  }

  // One job: the tree below a part, its nodes counted from the start of its own vector.
  u32 subtree(const Part& p, int depth, std::vector<LightNode>& nodes) {
    Part child[16];
    const int count = children_of(p, depth, child);
    const u32 index = static_cast<u32>(nodes.size());
    nodes.push_back({});
    for (int i = 0; i < count; ++i) {
      const u32 lane = static_cast<u32>(i);
      const u32 c = child[i].size() == 1 ? 0 : subtree(child[i], depth + 1, nodes);
      set_cluster(nodes[index], lane, child[i], c);
    }
    return index;
  }

  // Lays all subtrees out behind the top, in the order of the jobs, and notes where everything is.
  void join(LightTree& tree, const std::vector<Job>& jobs,
            std::vector<std::vector<LightNode>>& parts) {
    std::vector<size_t> base(jobs.size());
    size_t count = tree.nodes.size();
    for (size_t i = 0; i < jobs.size(); ++i) {
      base[i] = count;
      count += parts[i].size();
      if (jobs[i].slot != kNone) {
        tree.nodes[jobs[i].slot >> 4].child[jobs[i].slot & 15u] = static_cast<u32>(base[i]);
      }
    }
    tree.nodes.resize(count);
#pragma omp parallel for schedule(dynamic, 1)
    for (size_t i = 0; i < jobs.size(); ++i) {
      for (LightNode& n : parts[i]) {
        for (u32 lane = 0; lane < 16; ++lane) {
          // Only nodes below the job's own root are named, so 0 is an unused lane.
          if (n.child[lane] != 0 && !(n.child[lane] & kLightBit)) {
            n.child[lane] += static_cast<u32>(base[i]);
          }
        }
      }
      std::copy(parts[i].begin(), parts[i].end(),
                tree.nodes.begin() + static_cast<std::ptrdiff_t>(base[i]));
      parts[i] = {};
    }
    tree.slot_of_node.assign(count, kNone);
    tree.slot_of_light.assign(leaves_.size(), kNone);
#pragma omp parallel for schedule(static)
    for (size_t i = 0; i < count; ++i) {
      for (u32 lane = 0; lane < 16; ++lane) {
        const u32 child = tree.nodes[i].child[lane];
        const u32 slot = static_cast<u32>(i) << 4 | lane;
        if (child & kLightBit) {
          tree.slot_of_light[child & ~kLightBit] = slot;
        } else if (child != 0) {
          tree.slot_of_node[child] = slot;
        }
      }
    }
  }
};

}  // namespace

LightTreeNeeds light_tree_needs(size_t lights) {
  const size_t nodes = static_cast<size_t>(static_cast<double>(lights) / kUsualNode * 1.4) + 1;
  return {nodes * (sizeof(LightNode) + sizeof(u32)) + lights * sizeof(u32),
          nodes * sizeof(LightNode)};
}

LightTree build_light_tree(std::vector<LightLeaf> leaves) {
  LightTree tree;
  if (leaves.empty()) return tree;
  for_all(leaves.size(), [&](size_t i) { leaves[i].light = static_cast<u32>(i); });
  Builder(leaves).build(tree);
  return tree;
}

}  // namespace parhelion
