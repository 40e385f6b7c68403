// Building the tree: top-down, by the surface area heuristic, into nodes of sixteen children.
//
// Primitives are first sorted into the cells of a grid, from which two or three levels of nodes are
// made at once, and their parts into cells of their own. Parts of some thousand, and larger ones
// that lie too unevenly for that, such as whole scenes, are divided two by two down to leaves, the
// larger ones between cells; the largest of these forks go where they cost less, and the best nodes
// of sixteen over all of them are found. Of many primitives their numbers are sorted, and boxes are
// made when they are asked for; only parts of up to kLargeJob, and groups of no more than that, are
// copied with their boxes. Nothing is kept but the order that results, the nodes, and how many
// primitives each leaf has; nodes and blocks are then written where the scene has them.
//
// The tree depends on the primitives alone, not on the number of threads: sums over parts are only
// minima, maxima and counts, which no order changes, sorting keeps the order within a cell, and
// what is a thread's job and what is divided by all of them is told by how many primitives it has.
#pragma once
#include <omp.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <deque>
#include <limits>
#include <numeric>
#include <utility>
#include <vector>

#include "../core/view.h"
#include "array.h"
#include "bins.h"
#include "boxes.h"
#include "cell_sort.h"
#include "grid.h"
#include "memory.h"
#include "order.h"
#include "sah.h"
#include "shared_forks.h"
#include "tasks.h"
#include "threads.h"

namespace parhelion {

// By kind of shape; instances have no blocks.
using KindCounts = std::array<u32, 8>;

}  // namespace parhelion

namespace parhelion::tree {

// `Leaves` knows the primitives by their numbers: `ref(i)`; before it, some time apart,
// `prefetch(i)` and `prefetch_vertices(i)`, which reads what the first one fetches; `kind(ref)`;
// and `write(kind, ids, n, index)`, which makes block `index` of up to sixteen of one kind.
// Instances are leaves by themselves: `instance_leaf(ref)`.
template <class Leaves>
class TreeBuilder {
 public:
  TreeBuilder(size_t count, const Leaves& leaves) : count_(count), leaves_(leaves) {}

  // Makes the tree, apart from what write() writes. Returns the first primitive without a box, or
  // the count; with one, there is no tree. expect: told, before it is taken, how much memory parts
  // that are divided take beside what expected_bytes() says of the whole.
  template <class Expect>
  size_t plan(const Expect& expect) {
    order_ = Array<u32>(count_);
    const bool few = count_ <= kLargeJob;
    if (few) {
      expect(count_ * kCopied + bytes_of_grid(count_));
      refs_ = Array<Ref>(count_);
      spare_ = Array<Ref>(count_);
    }
    Extent box, centers;
    size_t lost = count_;
#pragma omp parallel if (count_ > kFewElements)
    {
      Extent my_box, my_centers;
      size_t my_lost = count_;
#pragma omp for nowait
      for (size_t i = 0; i < count_; ++i) {
        order_[i] = static_cast<u32>(i);
        const Ref r = leaves_.ref(i);
        if (few) refs_[i] = r;
        my_box.grow(r);
        my_centers.grow(center_of(r));
        for (int k = 0; k < 3; ++k) {
          if (!(r.low[k] <= r.high[k])) my_lost = std::min(my_lost, i);
        }
      }
#pragma omp critical(parhelion_measure)
      {
        box.grow(my_box);
        centers.grow(my_centers);
        lost = std::min(lost, my_lost);
      }
    }
    if (lost < count_) return lost;
    bounds_ = box.box();
    if (few) {
      divide_few({refs_.data(), count_, box, centers});
      u64 uneven = 0;
      for (const Uneven& u : uneven_) uneven += u.size;
      expect(count_ * kCopied + bytes_of_shared_forks(uneven) + in_turn() * kForked);
      make_jobs(0);
      refs_ = {}, spare_ = {};
    } else {
      const std::vector<Open> large = divide_many(centers);
      u64 most = 0;
      for (const Open& part : large) most = std::max(most, u64{part.size});
      expect(
          std::max(in_turn() * (kCopied + kForked), most * kCopied + bytes_of_shared_forks(most)));
      make_jobs(0);
      for (const Open& part : large) make_large(part);
    }
    count_up();
    return lost;
  }

  // Bytes of a plan until it is written: of so many primitives, before it is made.
  static u64 expected_bytes(u64 count) {
    return count * sizeof(u32) + count / kLeafSize * (sizeof(Leaf) + sizeof(Node) / kLeafSize);
  }
  // And of this one.
  u64 plan_bytes() const {
    u64 bytes = order_.bytes() + top_.capacity() * sizeof(Node);
    for (const Job& job : jobs_) {
      bytes += sizeof(Job) + job.made.nodes.capacity() * sizeof(Node) +
               job.made.leaves.capacity() * sizeof(Leaf);
    }
    return bytes;
  }

  Aabb bounds() const { return bounds_; }
  size_t node_count() const { return node_count_; }
  // Leaves that are blocks.
  const std::array<size_t, 8>& block_count() const { return block_count_; }

  // Writes the nodes, whose first is the scene's node `node_base`, and the blocks, from block_base
  // of each kind on. Returns the root, and gives back the memory that was used.
  Child write(Node* nodes, u32 node_base, const KindCounts& block_base) {
    if (count_ == 0) {
      const u32 block = block_base[static_cast<u32>(ShapeKind::sphere)];
      leaves_.write(ShapeKind::sphere, nullptr, 0, block);  // a leaf that nothing hits
      return make_leaf(ShapeKind::sphere, block);
    }
    std::vector<u32> first_node(jobs_.size());
    std::vector<KindCounts> first_block(jobs_.size());
    u32 next_node = node_base + static_cast<u32>(top_.size());
    KindCounts next_block = block_base;
    for (size_t i = 0; i < jobs_.size(); ++i) {
      first_node[i] = next_node;
      first_block[i] = next_block;
      next_node += static_cast<u32>(jobs_[i].made.nodes.size());
      for (size_t k = 0; k < 8; ++k) next_block[k] += jobs_[i].made.blocks[k];
    }
    Child root = node_base;
    for (Node& n : top_) {
      for (Child& c : n.child) c += node_base;  // what has a job below it is set next
    }
    for (size_t i = 0; i < jobs_.size(); ++i) {
      const Job& job = jobs_[i];
      const Child c = moved(job.made.root, first_node[i], first_block[i]);
      if (job.node == kNoNode) {
        root = c;
      } else {
        top_[job.node].child[job.lane] = c;
      }
    }
    put_top_in_order(node_base);
    std::copy(top_.begin(), top_.end(), nodes);
    const std::vector<size_t> turns = largest_first(0);
#pragma omp parallel for schedule(dynamic, 1) if (turns.size() > 1)
    for (size_t turn = 0; turn < turns.size(); ++turn) {
      const size_t i = turns[turn];
      const Local& made = jobs_[i].made;
      Node* to = nodes + (first_node[i] - node_base);
      for (const Node& n : made.nodes) {
        Node& there = *to++ = n;
        for (int lane = 0; lane < 16; ++lane) {
          if (is_there(n, lane)) {
            there.child[lane] = moved(n.child[lane], first_node[i], first_block[i]);
          }
        }
      }
      KindCounts block = first_block[i];
      const u32* ids = order_.data() + jobs_[i].first;
      const u32* const end = ids + jobs_[i].size;
      for (const Leaf& leaf : made.leaves) {
        prefetch(ids, leaf.count, static_cast<size_t>(end - ids));
        if (leaf.kind != ShapeKind::instance) {
          leaves_.write(leaf.kind, ids, leaf.count, block[static_cast<u32>(leaf.kind)]++);
        }
        ids += leaf.count;
      }
      jobs_[i].made = Local();
    }
    order_ = Array<u32>();
    return root;
  }

 private:
  // Below this many primitives a subtree is one thread's job; of more primitives than kLargeJob
  // none is, as they are copied, unless no grid divides them. Groups of no more are copied whole.
  static constexpr size_t kJobSize = 4096, kLargeJob = size_t{1} << 19;
  // A part of more primitives than kAlone, and than 1 / kFair of all, is divided by all threads.
  static constexpr size_t kAlone = 16384, kFair = 64;
  // Primitives are fetched in two steps, so many before the next step or before they are looked at.
  static constexpr size_t kAhead = 16;
  static constexpr size_t kNoNode = std::numeric_limits<size_t>::max();
  // Bytes a primitive: of what is copied, with room for as much, and of the forks of an uneven
  // part. What is gathered below them is not counted: leaves, and what lies deeper than nearly all
  // does.
  static constexpr u64 kCopied = 2 * sizeof(Ref);
  static constexpr u64 kForked = forks_over(64) * sizeof(Fork) / 64;

  // In the order of its primitives.
  struct Leaf {
    ShapeKind kind;
    u32 count;
  };
  // A tree below a part; its indices are counted from its own first node and blocks. The
  // primitives of its leaves go where those of the part were.
  struct Local {
    std::vector<Node> nodes;
    std::vector<Leaf> leaves;
    KindCounts blocks{};
    Child root = 0;
    u32* next = nullptr;
    std::array<std::vector<Expected>, 8> of_block;  // by kind, until the nodes are in order
    Expected expected{};
  };
  // What lies below a lane of a node: primitives [first, first + size) of those that are divided.
  struct Open {
    size_t first, size;
    int depth;
    size_t node;
    int lane;
  };
  // refs: those of the part, and room for as many, if they are there before it is divided; forks:
  // those of the part, if they are.
  struct Job : Open {
    Ref* refs = nullptr;
    Ref* spare = nullptr;
    const Fork* forks = nullptr;
    Local made = {};
  };
  // A large part that no grid divides.
  struct Uneven : Open {
    Uneven(const Job& job, const Part& measured) : Open(job), part(measured), spare(job.spare) {}
    const Part part;
    Ref* const spare;
    SharedForks forks;
  };

  const size_t count_;
  const Leaves& leaves_;
  Array<u32> order_;
  Array<Ref> refs_, spare_;  // of all primitives, where they are few
  std::vector<Node> top_;
  std::vector<Job> jobs_;
  std::deque<Uneven> uneven_;
  Aabb bounds_{{0, 0, 0}, {0, 0, 0}};
  size_t node_count_ = 0;
  std::array<size_t, 8> block_count_{};

  static Child moved(Child c, u32 node_base, const KindCounts& block_base) {
    return c & kLeafBit ? c + block_base[static_cast<u32>(leaf_kind(c))] : c + node_base;
  }

  void count_up() {
    node_count_ = top_.size();
    block_count_[static_cast<u32>(ShapeKind::sphere)] = count_ == 0;
    for (const Job& job : jobs_) {
      node_count_ += job.made.nodes.size();
      for (size_t k = 0; k < 8; ++k) block_count_[k] += job.made.blocks[k];
    }
  }

  // While the cells of a grid are filled.
  static u64 bytes_of_grid(u64 primitives) {
    const u64 filled = static_cast<u64>(omp_get_max_threads()) * kMostCells;
    const u64 merged = std::min(primitives / kPerCell, u64{kMostCells});
    return (std::min(primitives, filled) + merged) * sizeof(Bin) +
           primitives * sizeof(std::uint16_t);
  }

  // While the forks of uneven parts are made: each primitive has either those over it or a share of
  // the cells that it is sorted into, of chunks, of all and of slabs of these.
  static u64 bytes_of_shared_forks(u64 primitives) {
    const u64 chunks = std::min(static_cast<u64>(omp_get_max_threads()), u64{kPerCell});
    const u64 cells = (chunks + 2) * sizeof(Bin) / kPerCell + sizeof(std::uint16_t);
    return primitives * std::max(kForked, cells);
  }

  // Gives each thread some parts, or all of them one that is uneven. Boxes of so few are kept from
  // the first time they are made.
  void divide_few(const Part& whole) {
    if (count_ == 0) return;
    const Job all = {{0, count_, 0, kNoNode, 0}, refs_.data(), spare_.data()};
    std::vector<Open> below;
    if (count_ <= kJobSize || whole.is_point()) {
      jobs_.push_back(all);
      return;
    }
    if (!divide<ByAllThreads>(all.refs, all.spare, count_, whole.centers, 0, kJobSize, kCrowdOfAll,
                              top_, below)) {
      uneven_.emplace_back(all, whole);
      return;
    }
    for (const Open& part : below) add(within(all, part));
  }

  // Of a part that has been divided, and whose boxes so went to where there was room.
  static Job within(const Job& whole, Open part) {
    Job job = {part, whole.spare + part.first, whole.refs + part.first};
    job.first += whole.first;
    return job;
  }

  bool is_large(size_t size) const { return size > kAlone && size > count_ / kFair; }

  // A job for one thread, or several, of what is large: the same tree by all threads.
  void add(const Job& part) {
    if (!is_large(part.size) || part.depth > kMaxTreeDepth / 2) {
      jobs_.push_back(part);
      return;
    }
    Part measured =
        measure_by<ByAllThreads>(part.size, [&](size_t i) -> const Ref& { return part.refs[i]; });
    measured.refs = part.refs;
    const size_t node = top_.size();
    std::vector<Open> below;
    if (divide<ByAllThreads>(part.refs, part.spare, part.size, measured.centers, part.depth, 0,
                             kCrowd, top_, below)) {
      link(part, node);
      for (const Open& o : below) add(within(part, o));
    } else if (measured.is_point()) {
      jobs_.push_back(part);
    } else {
      uneven_.emplace_back(part, measured);
    }
  }

  void link(const Open& part, size_t node) {
    if (part.node != kNoNode) top_[part.node].child[part.lane] = static_cast<Child>(node);
  }

  // Of many, parts that are too large for one thread are divided by all of them. Returns those that
  // are large all the same, but not too large to be copied.
  std::vector<Open> divide_many(const Extent& centers) {
    std::vector<Open> todo = {{0, count_, 0, kNoNode, 0}}, large;
    while (!todo.empty()) {
      const Open part = todo.back();
      todo.pop_back();
      if (part.size > kLargeJob) {
        if (divide_large(part, centers, todo)) continue;
      } else if (is_large(part.size)) {
        large.push_back(part);
        continue;
      }
      jobs_.push_back({part});
    }
    return large;
  }

  void make_large(const Open& part) {
    Array<Ref> refs(part.size), spare(part.size);
    for_all(part.size, [&](size_t k) { refs[k] = fetched(part, k); });
    const size_t before = jobs_.size();
    add({part, refs.data(), spare.data()});
    make_jobs(before);
  }

  Ref fetched(const Open& part, size_t k) const {
    const u32* const ids = order_.data() + part.first;
    prefetch(ids + k, 1, part.size - k);
    return leaves_.ref(ids[k]);
  }
  // Of `size` primitives, those that will be looked at after the next `count`.
  void prefetch(const u32* ids, size_t count, size_t size) const {
    for (size_t k = kAhead; k < kAhead + count && k < size; ++k) {
      if (k + kAhead < size) leaves_.prefetch(ids[k + kAhead]);
      leaves_.prefetch_vertices(ids[k]);
    }
  }

  // From the job `first` on: these, the forks of what is uneven, and the jobs that they become.
  void make_jobs(size_t first) {
    const std::vector<size_t> turns = largest_first(first);
    const size_t uneven = uneven_.size();
    MemoryGuard guard;
#pragma omp parallel if (uneven > 0 || turns.size() > 1)
    {
      Array<Ref> refs, spare;
#pragma omp for schedule(dynamic, 1)
      for (size_t turn = 0; turn < uneven + turns.size(); ++turn) {
        if (turn < uneven) {
          Uneven& u = uneven_[turn];
          u.forks.begin(u.part, u.spare);
        } else {
          guard.run([&] { make(jobs_[turns[turn - uneven]], refs, spare); });
        }
      }
    }
    guard.check();
    if (uneven == 0) return;
    std::deque<Uneven> forked = std::exchange(uneven_, {});
    const size_t next = jobs_.size();
    for (Uneven& u : forked) add_forked(u.forks.finish(), u);
    make_jobs(next);
  }

  // Nodes over forks, down to what is a job for one thread.
  void add_forked(const Fork& top, const Open& place) {
    if (top.size <= kForksATask || place.depth > kMaxTreeDepth / 2) {
      jobs_.push_back({place, nullptr, nullptr, &top});
      return;
    }
    const Fork* child[16];
    const int count = children_of(top, child);
    const size_t index = top_.size();
    link(place, index);
    top_.push_back(empty_node());
    size_t first = place.first;
    for (int i = 0; i < count; ++i) {
      const Fork& below = *child[i];
      set_box(top_[index], i, below.box);
      add_forked(below, {first, below.size, place.depth + 1, index, i});
      first += below.size;
    }
  }

  // refs and spare: the thread's, for parts whose boxes are not kept.
  void make(Job& job, Array<Ref>& refs, Array<Ref>& spare) {
    job.made.next = order_.data() + job.first;
    if (job.forks) {
      job.made.root = join(*job.forks, job.depth, job.made);
    } else if (job.refs) {
      job.made.root = subtree(job.refs, job.spare, job.size, job.depth, job.made);
    } else {
      if (refs.size() < job.size) {
        refs = {}, spare = {};  // before others are asked for
        refs = Array<Ref>(job.size);
        spare = Array<Ref>(job.size);
      }
      for (size_t k = 0; k < job.size; ++k) refs[k] = fetched(job, k);
      job.made.root = subtree(refs.data(), spare.data(), job.size, job.depth, job.made);
    }
    put_in_order(job.made);
    job.refs = job.spare = nullptr;  // which will not be there for long
    job.forks = nullptr;
    job.made.nodes.shrink_to_fit();
    job.made.leaves.shrink_to_fit();
  }

  static void put_in_order(Local& made) {
    const auto of_leaf = [&](Child c) {
      const ShapeKind kind = leaf_kind(c);
      if (kind == ShapeKind::instance) return kOfInstance;
      return made.of_block[static_cast<u32>(kind)][c & kLeafIndexMask];
    };
    made.expected = made.nodes.empty()
                        ? of_leaf(made.root)
                        : put_all_in_order(made.nodes, [&](size_t i, int lane, const auto& below) {
                            const Child c = made.nodes[i].child[lane];
                            return c & kLeafBit ? of_leaf(c) : below[c];
                          });
    made.of_block = {};
  }

  // The uppermost nodes, whose children are where the scene has them.
  void put_top_in_order(u32 node_base) {
    if (top_.empty()) return;
    std::vector<std::array<Expected, 16>> of_job(top_.size());
    for (const Job& job : jobs_) {
      if (job.node != kNoNode) of_job[job.node][job.lane] = job.made.expected;
    }
    put_all_in_order(top_, [&](size_t i, int lane, const auto& below) {
      const Child c = top_[i].child[lane];
      const bool top = (c & kLeafBit) == 0 && c - node_base < top_.size();
      return top ? below[c - node_base] : of_job[i][lane];
    });
  }

  // So that no thread waits in the end for another's large part.
  std::vector<size_t> largest_first(size_t first) const {
    std::vector<size_t> turns(jobs_.size() - first);
    std::iota(turns.begin(), turns.end(), first);
    std::stable_sort(turns.begin(), turns.end(),
                     [&](size_t a, size_t b) { return jobs_[a].size > jobs_[b].size; });
    return turns;
  }

  // Primitives of the largest parts that are divided at a time, one a thread.
  u64 in_turn() const {
    const std::vector<size_t> turns = largest_first(0);
    const size_t most = std::min(turns.size(), static_cast<size_t>(omp_get_max_threads()));
    u64 sum = 0;
    for (size_t turn = 0; turn < most; ++turn) sum += jobs_[turns[turn]].size;
    return sum;
  }

  // centers: of all primitives.
  bool divide_large(const Open& part, Extent centers, std::vector<Open>& todo) {
    u32* const ids = order_.data() + part.first;
    if (part.depth > 0) {
      centers = measure_by<ByAllThreads>(part.size, [&](size_t i) {
                  return leaves_.ref(ids[i]);
                }).centers;
    }
    Array<u32> sorted(part.size);
    std::vector<Open> below;
    const size_t node = top_.size();
    if (!divide<ByAllThreads>(ids, sorted.data(), part.size, centers, part.depth, kJobSize, 0, top_,
                              below)) {
      return false;
    }
    link(part, node);
    if (part.size == count_) {
      std::swap(order_, sorted);
    } else {
      std::copy(sorted.begin(), sorted.end(), ids);
    }
    for (auto p = below.rbegin(); p != below.rend(); ++p) {
      todo.push_back({part.first + p->first, p->size, p->depth, p->node, p->lane});
    }
    return true;
  }

  Ref ref_of(u32 id) const { return leaves_.ref(id); }
  const Ref& ref_of(const Ref& r) const { return r; }
  // Of several: where they are, or made in `room`.
  const Ref* refs_of(const u32* ids, size_t count, Ref* room) const {
    std::transform(ids, ids + count, room, [&](u32 id) { return leaves_.ref(id); });
    return room;
  }
  const Ref* refs_of(const Ref* refs, size_t, Ref*) const { return refs; }

  // The nodes over `items`, which go to `sorted` by what is below: primitives or numbers of these.
  // The first node is the uppermost. A part of no more than `enough` is not divided. False, where
  // all centres are one, where most lie in cells that have `crowd` times the usual number, unless
  // that is 0, or the tree is so deep that its depth must be bounded.
  template <class Share, class Item>
  bool divide(const Item* items, Item* sorted, size_t n, const Extent& centers, int depth,
              size_t enough, size_t crowd, std::vector<Node>& nodes,
              std::vector<Open>& below) const {
    if (depth > kMaxTreeDepth / 2) return false;
    const Grid grid(centers, n);
    const size_t cells = grid.count();
    if (cells < 2) return false;
    // Most parts that are not can be told by a few, before all are sorted into cells.
    if (crowd > 0 &&
        crowded(grid, n, kSampled, 2 * crowd, [&](size_t i) { return ref_of(items[i]); })) {
      return false;
    }
    const CellSort<Share> sort(grid, n, [&](size_t first, size_t count, Ref* room) {
      return refs_of(items + first, count, room);
    });
    if (crowd > 0 && crowded(sort.bins(), n, crowd, [](const Bin& b) { return b.count; })) {
      return false;
    }
    std::vector<std::uint16_t> part_of(cells);
    node_over(grid, sort.bins(), all_of(grid, sort.bins()), depth, enough, nodes, below, part_of);
    const std::vector<size_t> begin = sort.sort_to(items, sorted, below.size(), part_of);
    for (size_t p = 0; p < below.size(); ++p) below[p].first = begin[p];
    return true;
  }

  Child node_over(const Grid& grid, const std::vector<Bin>& bins, const Cells& all, int depth,
                  size_t enough, std::vector<Node>& nodes, std::vector<Open>& below,
                  std::vector<std::uint16_t>& part_of) const {
    Cells child[16];
    const int count = children_of(grid, bins, all, child);
    const size_t index = nodes.size();
    nodes.push_back(empty_node());
    for (int i = 0; i < count; ++i) {
      const Cells& c = child[i];
      set_box(nodes[index], i, c.sum.box);
      if (c.sum.count > enough && c.cells() >= kCellsANode && !c.whole &&
          depth < kMaxTreeDepth / 2) {
        const Child made = node_over(grid, bins, c, depth + 1, enough, nodes, below, part_of);
        nodes[index].child[i] = made;
        continue;
      }
      set_part(grid, c, below.size(), part_of);
      below.push_back({0, c.sum.count, depth + 1, index, i});
    }
    return static_cast<Child>(index);
  }

  static Node empty_node() {
    Node n;
    for (int k = 0; k < 3; ++k) {
      for (int i = 0; i < 16; ++i) n.low[k][i] = INFINITY, n.high[k][i] = -INFINITY;
    }
    for (Child& c : n.child) c = 0;
    return n;
  }
  static void set_box(Node& n, int lane, const Extent& e) {
    const Aabb b = e.box();
    for (int k = 0; k < 3; ++k) n.low[k][lane] = b.low[k], n.high[k][lane] = b.high[k];
  }

  // One job: the whole tree over n refs. spare: room for as many.
  Child subtree(Ref* refs, Ref* spare, size_t n, int depth, Local& out) const {
    const Part part = measure(refs, n);
    if (n > kGridSize) {
      const size_t index = out.nodes.size();
      std::vector<Open> below;
      if (divide<ByOneThread>(refs, spare, n, part.centers, depth, 0, kCrowd, out.nodes, below)) {
        for (const Open& o : below) {
          const Child c = subtree(spare + o.first, refs + o.first, o.size, o.depth, out);
          out.nodes[o.node].child[o.lane] = c;
        }
        return static_cast<Child>(index);
      }
    }
    return fine_tree(part, depth, out);
  }

  Child fine_tree(const Part& part, int depth, Local& out) const {
    if (part.size <= kLeafSize) return leaf(part, out);
    if (depth > kMaxTreeDepth / 2 || part.is_point()) return even_tree(part, depth, out);
    ForkRoom room(part.size);
    const Upkeep upkeep = upkeep_of(part, false);  // of most scenes, in which leaves stay full
    Fork& top = fork(part, upkeep, 0, room);
    if (part.size > kGridSize) Reinsertion::run(top, 1);
    return join(top, depth, out);
  }

  // Of what no cut divides, or what lies too deep: into parts of as many primitives each.
  Child even_tree(const Part& part, int depth, Local& out) const {
    if (part.size <= kLeafSize) return leaf(part, out);
    Part child[16];
    int count = 1;
    child[0] = part;
    while (count < 16) {
      Part& most = *std::max_element(child, child + count,
                                     [](const Part& a, const Part& b) { return a.size < b.size; });
      if (most.size <= kLeafSize) break;
      const Part whole = most;
      split_by_count(whole, most, child[count++]);
    }
    const size_t index = out.nodes.size();
    out.nodes.push_back(empty_node());
    for (int i = 0; i < count; ++i) {
      set_box(out.nodes[index], i, child[i].box);
      const Child c = even_tree(child[i], depth + 1, out);
      out.nodes[index].child[i] = c;
    }
    return static_cast<Child>(index);
  }

  // All primitives of a fork; returns where the next would go.
  static Ref* gather(const Fork& f, Ref* to) {
    if (f.refs) return std::copy(f.refs, f.refs + f.size, to);
    return gather(*f.right, gather(*f.left, to));
  }

  // Writes what the costs say.
  Child join(const Fork& top, int depth, Local& out) const {
    if (top.size <= kLeafSize) {
      Ref refs[kLeafSize];
      gather(top, refs);
      return leaf({refs, top.size, {}, {}}, out);
    }
    if (depth > kMaxTreeDepth / 2) {
      Array<Ref> refs(top.size);
      gather(top, refs.data());
      return even_tree(measure(refs.data(), refs.size()), depth, out);
    }
    const Fork* child[16];
    const int count = children_of(top, child);
    const size_t index = out.nodes.size();
    out.nodes.push_back(empty_node());
    for (int i = 0; i < count; ++i) {
      set_box(out.nodes[index], i, child[i]->box);
      const Child c = join(*child[i], depth + 1, out);
      out.nodes[index].child[i] = c;
    }
    return static_cast<Child>(index);
  }

  // A leaf, or, of primitives of several kinds, a node over one of each; instances stay apart.
  Child leaf(const Part& p, Local& out) const {
    Ref* const end = p.refs + p.size;
    const auto by_kind = [&](const Ref& a, const Ref& b) {
      return leaves_.kind(a) < leaves_.kind(b);
    };
    // which asks for memory
    if (!std::is_sorted(p.refs, end, by_kind)) std::stable_sort(p.refs, end, by_kind);
    const auto end_of = [&](const Ref* from) {
      const ShapeKind kind = leaves_.kind(*from);
      const Ref* to = from + 1;
      if (kind == ShapeKind::instance) return to;
      while (to != end && leaves_.kind(*to) == kind) ++to;
      return to;
    };
    const auto append = [&](const Ref* from, const Ref* to) -> Child {
      const ShapeKind kind = leaves_.kind(*from);
      out.leaves.push_back({kind, static_cast<u32>(to - from)});
      for (const Ref* r = from; r != to; ++r) *out.next++ = r->id;
      if (kind == ShapeKind::instance) return leaves_.instance_leaf(*from);
      out.of_block[static_cast<u32>(kind)].push_back(expected_of(from, to));
      return make_leaf(kind, out.blocks[static_cast<u32>(kind)]++);
    };
    if (end_of(p.refs) == end) return append(p.refs, end);
    const size_t index = out.nodes.size();
    out.nodes.push_back(empty_node());
    int lane = 0;
    for (const Ref* from = p.refs; from != end;) {
      const Ref* to = end_of(from);
      Extent box;
      for (const Ref* r = from; r != to; ++r) box.grow(*r);
      set_box(out.nodes[index], lane, box);
      out.nodes[index].child[lane++] = append(from, to);
      from = to;
    }
    return static_cast<Child>(index);
  }
};

}  // namespace parhelion::tree
