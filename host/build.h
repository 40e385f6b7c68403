// Building the tree: top-down, by the surface area heuristic over binned centres, straight into
// nodes of sixteen children.
//
// The tree depends on the primitives alone, not on the number of threads: sums over parts are only
// minima, maxima and counts, which no order changes, and the split into parallel jobs is by size.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "../core/view.h"

namespace parhelion {

struct Aabb {
  float low[3] = {INFINITY, INFINITY, INFINITY};
  float high[3] = {-INFINITY, -INFINITY, -INFINITY};

  void grow(const Aabb& b) {
    for (int k = 0; k < 3; ++k) {
      low[k] = std::min(low[k], b.low[k]);
      high[k] = std::max(high[k], b.high[k]);
    }
  }
  void grow(const float (&p)[3]) {
    for (int k = 0; k < 3; ++k) {
      low[k] = std::min(low[k], p[k]);
      high[k] = std::max(high[k], p[k]);
    }
  }
  // Half the surface; 0 for an empty box.
  float half_area() const {
    if (!(low[0] <= high[0])) return 0.0f;
    const float x = high[0] - low[0], y = high[1] - low[1], z = high[2] - low[2];
    return x * y + y * z + z * x;
  }
};

// The blocks of every kind of shape.
struct Blocks {
#define SHAPE(name, Type) std::vector<Type##Block> name##s;
#include "../core/shapes.def"
#undef SHAPE
};

// What the tree is built over: a primitive's box, its id, and the user's shape that it belongs to.
struct Ref {
  Aabb box;
  u32 id;
  u32 shape;

  float center(int axis) const { return 0.5f * (box.low[axis] + box.high[axis]); }
};

// `Leaves` knows the primitives: `kind(ref)`, and `append(refs, n, blocks)`, which makes a leaf of
// up to sixteen of one kind and returns it, its index counted from the start of `blocks`. Instances
// are leaves by themselves, and their index is final.
template <class Leaves>
class TreeBuilder {
 public:
  TreeBuilder(std::vector<Ref>& refs, const Leaves& leaves) : refs_(refs), leaves_(leaves) {}

  // Results; `root` is meaningless without references.
  std::vector<Node> nodes;
  Blocks blocks;
  Child root = 0;
  Aabb bounds;

  void build() {
    if (refs_.empty()) return;
    Part all = measure({0, refs_.size(), {}, {}});
    bounds = all.box;
    std::vector<Job> jobs;
    std::vector<Node> top;
    root = expand(all, 0, top, jobs);
    std::vector<Subtree> parts(jobs.size());
#pragma omp parallel for schedule(dynamic, 1) if (jobs.size() > 1)
    for (size_t i = 0; i < jobs.size(); ++i) {
      parts[i].root = subtree(jobs[i].part, jobs[i].depth, parts[i].nodes, parts[i].blocks);
    }
    join(std::move(top), jobs, parts);
  }

 private:
  static constexpr size_t kLeafSize = 16;
  static constexpr double kUsualLeaf = 11.0;  // references in a leaf, as measured on average
  static constexpr int kBins = 16;
  // Below this many references a subtree is one thread's job.
  static constexpr size_t kJobSize = 4096;

  struct Part {
    size_t first, last;
    Aabb box, centers;
    size_t size() const { return last - first; }
  };
  struct Job {
    Part part;
    int depth;
    size_t node;
    int lane;
  };
  struct Subtree {
    std::vector<Node> nodes;
    Blocks blocks;
    Child root = 0;
  };
  struct Bin {
    Aabb box, centers;
    size_t count = 0;
    void grow(const Bin& b) {
      box.grow(b.box);
      centers.grow(b.centers);
      count += b.count;
    }
  };

  std::vector<Ref>& refs_;
  const Leaves& leaves_;

  // Bounds of a part's boxes and of their centres.
  Part measure(Part p) {
    Bin sum;
#pragma omp parallel if (p.size() > kJobSize)
    {
      Bin mine;
#pragma omp for nowait
      for (size_t i = p.first; i < p.last; ++i) add_to(mine, refs_[i]);
#pragma omp critical(parhelion_measure)
      sum.grow(mine);
    }
    return {p.first, p.last, sum.box, sum.centers};
  }

  static void add_to(Bin& bin, const Ref& ref) {
    bin.box.grow(ref.box);
    const float center[3] = {ref.center(0), ref.center(1), ref.center(2)};
    bin.centers.grow(center);
    ++bin.count;
  }

  static int bin_of(float x, float low, float scale) {
    return std::min(kBins - 1, static_cast<int>((x - low) * scale));
  }

  // Divides a part in two of the least expected cost; by the middle one where centres coincide, or
  // where the tree would become too deep.
  void split(const Part& p, bool by_count, Part& left, Part& right) {
    int best_axis = -1, best_bin = 0;
    float best_cost = std::numeric_limits<float>::infinity();
    Bin bins[3][kBins];
    float scale[3];
    for (int k = 0; k < 3; ++k) {
      const float extent = p.centers.high[k] - p.centers.low[k];
      scale[k] = extent > 0.0f ? kBins * (1.0f - 1e-6f) / extent : 0.0f;
      if (!std::isfinite(scale[k])) scale[k] = 0.0f;
    }
    if (!by_count) {
      fill_bins(p, scale, bins);
      for (int k = 0; k < 3; ++k) {
        if (scale[k] == 0.0f) continue;
        float area_right[kBins];
        size_t count_right[kBins];
        Bin sum;
        for (int i = kBins - 1; i > 0; --i) {
          sum.grow(bins[k][i]);
          area_right[i] = sum.box.half_area();
          count_right[i] = sum.count;
        }
        sum = Bin();
        for (int i = 1; i < kBins; ++i) {
          sum.grow(bins[k][i - 1]);
          if (sum.count == 0 || count_right[i] == 0) continue;
          const float cost = sum.box.half_area() * static_cast<float>(sum.count) +
                             area_right[i] * static_cast<float>(count_right[i]);
          if (cost < best_cost) best_cost = cost, best_axis = k, best_bin = i;
        }
      }
    }
    if (best_axis < 0) {
      split_by_count(p, left, right);
      return;
    }
    const float low = p.centers.low[best_axis], s = scale[best_axis];
    const auto middle = std::partition(
        refs_.begin() + static_cast<std::ptrdiff_t>(p.first),
        refs_.begin() + static_cast<std::ptrdiff_t>(p.last),
        [&](const Ref& r) { return bin_of(r.center(best_axis), low, s) < best_bin; });
    const size_t cut = static_cast<size_t>(middle - refs_.begin());
    Bin sum_left, sum_right;
    for (int i = 0; i < kBins; ++i) (i < best_bin ? sum_left : sum_right).grow(bins[best_axis][i]);
    left = {p.first, cut, sum_left.box, sum_left.centers};
    right = {cut, p.last, sum_right.box, sum_right.centers};
  }

  void split_by_count(const Part& p, Part& left, Part& right) {
    int axis = 0;
    for (int k = 1; k < 3; ++k) {
      if (p.centers.high[k] - p.centers.low[k] > p.centers.high[axis] - p.centers.low[axis]) {
        axis = k;
      }
    }
    const size_t cut = p.first + p.size() / 2;
    const auto begin = refs_.begin();
    std::nth_element(
        begin + static_cast<std::ptrdiff_t>(p.first), begin + static_cast<std::ptrdiff_t>(cut),
        begin + static_cast<std::ptrdiff_t>(p.last), [axis](const Ref& a, const Ref& b) {
          return a.center(axis) < b.center(axis) ||
                 (a.center(axis) == b.center(axis) && a.id < b.id);
        });
    left = measure({p.first, cut, {}, {}});
    right = measure({cut, p.last, {}, {}});
  }

  void fill_bins(const Part& p, const float (&scale)[3], Bin (&bins)[3][kBins]) {
    const auto fill = [&](Bin(&into)[3][kBins], size_t i) {
      const Ref& ref = refs_[i];
      for (int k = 0; k < 3; ++k) {
        if (scale[k] == 0.0f) continue;
        add_to(into[k][bin_of(ref.center(k), p.centers.low[k], scale[k])], ref);
      }
    };
    if (p.size() <= kJobSize) {
      for (size_t i = p.first; i < p.last; ++i) fill(bins, i);
      return;
    }
#pragma omp parallel
    {
      Bin mine[3][kBins];
#pragma omp for nowait
      for (size_t i = p.first; i < p.last; ++i) fill(mine, i);
#pragma omp critical(parhelion_bins)
      for (int k = 0; k < 3; ++k) {
        for (int i = 0; i < kBins; ++i) bins[k][i].grow(mine[k][i]);
      }
    }
  }

  // Children for a part of n references such that the levels below are filled evenly: sixteen each
  // from the top would leave the last level of nodes two or three leaves.
  static int fanout(size_t n) {
    const double leaves = static_cast<double>(n) / kUsualLeaf;
    int levels = 1;
    for (double capacity = 16.0; capacity < leaves; capacity *= 16.0) ++levels;
    return std::clamp(static_cast<int>(std::ceil(std::pow(leaves, 1.0 / levels))), 2, 16);
  }

  // Up to sixteen parts of p, made by dividing the one of largest surface again and again; of most
  // references where the tree has grown so deep that its depth must be bounded.
  int children_of(const Part& p, int depth, Part (&child)[16]) {
    const bool by_count = depth > kMaxTreeDepth / 2;
    const int wanted = by_count ? 16 : fanout(p.size());
    int count = 1;
    child[0] = p;
    while (count < wanted) {
      int next = -1;
      float largest = -1.0f;
      for (int i = 0; i < count; ++i) {
        const float size =
            by_count ? static_cast<float>(child[i].size()) : child[i].box.half_area();
        if (child[i].size() > kLeafSize && size > largest) next = i, largest = size;
      }
      if (next < 0) break;
      const Part whole = child[next];
      split(whole, by_count, child[next], child[count]);
      ++count;
    }
    return count;
  }

  static Node empty_node() {
    Node n;
    for (int k = 0; k < 3; ++k) {
      for (int i = 0; i < 16; ++i) n.low[k][i] = INFINITY, n.high[k][i] = -INFINITY;
    }
    for (Child& c : n.child) c = 0;
    return n;
  }
  static void set_box(Node& n, int lane, const Aabb& b) {
    for (int k = 0; k < 3; ++k) n.low[k][lane] = b.low[k], n.high[k][lane] = b.high[k];
  }

  // The part of the tree above the jobs.
  Child expand(const Part& p, int depth, std::vector<Node>& top, std::vector<Job>& jobs) {
    if (p.size() <= kJobSize && depth == 0) {
      jobs.push_back({p, depth, kNoNode, 0});
      return 0;
    }
    Part child[16];
    const int count = children_of(p, depth, child);
    const size_t index = top.size();
    top.push_back(empty_node());
    for (int i = 0; i < count; ++i) {
      set_box(top[index], i, child[i].box);
      if (child[i].size() <= kJobSize) {
        jobs.push_back({child[i], depth + 1, index, i});
      } else {
        const Child c = expand(child[i], depth + 1, top, jobs);
        top[index].child[i] = c;
      }
    }
    return static_cast<Child>(index);
  }

  // One job: the whole tree below a part, its indices counted from the start of its own vectors.
  Child subtree(const Part& p, int depth, std::vector<Node>& local, Blocks& leaves) {
    if (p.size() <= kLeafSize) return leaf(p, local, leaves);
    Part child[16];
    const int count = children_of(p, depth, child);
    const size_t index = local.size();
    local.push_back(empty_node());
    for (int i = 0; i < count; ++i) {
      set_box(local[index], i, child[i].box);
      const Child c = subtree(child[i], depth + 1, local, leaves);
      local[index].child[i] = c;
    }
    return static_cast<Child>(index);
  }

  // A leaf, or, of primitives of several kinds, a node over one of each; instances stay apart.
  Child leaf(const Part& p, std::vector<Node>& local, Blocks& leaves) {
    Ref* const first = &refs_[p.first];
    Ref* const last = first + p.size();
    std::stable_sort(first, last,
                     [&](const Ref& a, const Ref& b) { return leaves_.kind(a) < leaves_.kind(b); });
    const auto end_of = [&](const Ref* from) {
      const ShapeKind kind = leaves_.kind(*from);
      const Ref* to = from + 1;
      if (kind == ShapeKind::instance) return to;
      while (to != last && leaves_.kind(*to) == kind) ++to;
      return to;
    };
    if (end_of(first) == last) return leaves_.append(first, p.size(), leaves);
    const size_t index = local.size();
    local.push_back(empty_node());
    int lane = 0;
    for (const Ref* from = first; from != last;) {
      const Ref* to = end_of(from);
      Aabb box;
      for (const Ref* r = from; r != to; ++r) box.grow(r->box);
      set_box(local[index], lane, box);
      local[index].child[lane++] = leaves_.append(from, static_cast<size_t>(to - from), leaves);
      from = to;
    }
    return static_cast<Child>(index);
  }

  // Lays the top and all subtrees out in one array each, in the order of the jobs.
  void join(std::vector<Node> top, const std::vector<Job>& jobs, std::vector<Subtree>& parts) {
    size_t node_count = top.size();
    std::vector<u32> node_base(jobs.size());
    std::vector<std::array<u32, 8>> block_base(jobs.size());  // by kind; instances stay at 0
    std::array<u32, 8> block_count{};
    for (size_t i = 0; i < jobs.size(); ++i) {
      node_base[i] = static_cast<u32>(node_count);
      block_base[i] = block_count;
      node_count += parts[i].nodes.size();
#define SHAPE(name, Type)                           \
  block_count[static_cast<u32>(ShapeKind::name)] += \
      static_cast<u32>(parts[i].blocks.name##s.size());
#include "../core/shapes.def"
#undef SHAPE
    }
    nodes = std::move(top);
    nodes.resize(node_count);
#define SHAPE(name, Type) blocks.name##s.resize(block_count[static_cast<u32>(ShapeKind::name)]);
#include "../core/shapes.def"
#undef SHAPE
    const auto moved = [&](Child c, size_t i) {
      return c & kLeafBit ? c + block_base[i][static_cast<u32>(leaf_kind(c))] : c + node_base[i];
    };
    for (size_t i = 0; i < jobs.size(); ++i) {
      const Child c = moved(parts[i].root, i);
      if (jobs[i].node == kNoNode) {
        root = c;
      } else {
        nodes[jobs[i].node].child[jobs[i].lane] = c;
      }
    }
#pragma omp parallel for schedule(dynamic, 1) if (jobs.size() > 1)
    for (size_t i = 0; i < jobs.size(); ++i) {
      Subtree& part = parts[i];
      for (Node& n : part.nodes) {
        for (int lane = 0; lane < 16; ++lane) {
          if (n.low[0][lane] <= n.high[0][lane]) n.child[lane] = moved(n.child[lane], i);
        }
      }
      std::copy(part.nodes.begin(), part.nodes.end(), nodes.begin() + node_base[i]);
#define SHAPE(name, Type)                                           \
  std::copy(part.blocks.name##s.begin(), part.blocks.name##s.end(), \
            blocks.name##s.begin() + block_base[i][static_cast<u32>(ShapeKind::name)]);
#include "../core/shapes.def"
#undef SHAPE
      part = Subtree();
    }
  }

  static constexpr size_t kNoNode = std::numeric_limits<size_t>::max();
};

}  // namespace parhelion
