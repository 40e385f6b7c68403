// What a ray is still to visit of a tree. Of the children that one node puts there the nearest lies
// on top, or, where any hit will do, the node's last.
#pragma once
#include "view.h"

namespace parhelion::PH_ISA {

// A level of nodes leaves at most fifteen behind, since one is gone to; the last may write sixteen,
// a whole register.
inline constexpr u32 kStackSize = 15 * kMaxTreeDepth + 1;

// What is the next to visit is picked without branches, or with few: how many boxes a ray meets,
// and in which order, cannot be predicted.
#if defined(__AVX512F__)

// Sorted in registers, and without branches where no more than four are put there.
class Stack {
 public:
  // Apart, so that how many there are can stay in a register.
  struct Room {
    u32 near[kStackSize];
    Child child[kStackSize];
  };
  PH_INLINE explicit Stack(Room& room) : near_(room.near), child_(room.child) {}

  // What a walk begins with: the children of one node, as they will lie there.
  struct alignas(64) Start {
    u32 near[16];
    Child child[16];
    u32 count;
  };
  // A bit for each child in `hits`; near: where the ray enters their boxes.
  template <bool kAny>
  PH_INLINE static void prepare(const Node& node, const Lanes& near, const LaneMask& hits,
                                Start& out) {
    if constexpr (kAny) {
      out.count = compress(node, bits(hits), out.child);
    } else {
      out.count = order(node, near, bits(hits), out.near, out.child);
    }
  }
  // Puts them on an empty stack, but for the next. False if there is none.
  template <bool kAny>
  PH_INLINE bool begin(const Start& start, Child& next) {
    if (start.count == 0) return false;
    if constexpr (!kAny) _mm512_storeu_si512(near_, _mm512_load_si512(start.near));
    _mm512_storeu_si512(child_, _mm512_load_si512(start.child));
    size_ = start.count - 1;
    next = start.child[size_];
    return true;
  }

  // Puts the children of a node there that a ray hits. False if the next is to be taken from there;
  // else `next` is the nearest of them, which is not put there.
  template <bool kAny>
  PH_INLINE bool push(const Node& node, const Lanes& near, const LaneMask& hits, Child& next) {
    const u32 met = bits(hits);
    if constexpr (kAny) {
      size_ += compress(node, met, child_ + size_);
      return false;
    }
    if ((met & (met - 1)) != 0) {
      size_ += order(node, near, met, near_ + size_, child_ + size_) - 1;
      next = child_[size_];
      return true;
    }
    if (met != 0) next = node.child[lowest_bit(met)];  // which need not wait for the stack
    return met != 0;
  }

  // False if there is none.
  PH_INLINE bool pop(Child& child) {
    if (size_ == 0) return false;
    child = child_[--size_];
    return true;
  }
  // The uppermost whose box begins before `limit`.
  PH_INLINE bool pop(Child& child, float limit) {
    do {
      if (size_ == 0) return false;
      --size_;
    } while (!(__builtin_bit_cast(float, near_[size_] & ~15u) <= limit));
    child = child_[size_];
    return true;
  }

 private:
  // In their order in the node; returns how many there are.
  PH_INLINE static u32 compress(const Node& node, u32 hits, Child* to) {
    const __m512i children = _mm512_load_si512(node.child);
    _mm512_storeu_si512(to, _mm512_maskz_compress_epi32(static_cast<__mmask16>(hits), children));
    return compiler::ones(hits);
  }
  // The nearest last; returns how many there are.
  PH_INLINE static u32 order(const Node& node, const Lanes& near, u32 hits, u32* near_to,
                             Child* child_to) {
    // Of floats that are not negative the order is that of their bits. The last four give way to
    // the child's number, so the distances that are kept are less by that.
    const __m512i numbers = _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    const __m512i distances =
        _mm512_andnot_si512(_mm512_set1_epi32(15), _mm512_castps_si512(near.part[0]));
    const __m512i found = _mm512_maskz_compress_epi32(static_cast<__mmask16>(hits),
                                                      _mm512_or_si512(distances, numbers));
    const u32 count = compiler::ones(hits);
    __m512i sorted = _mm512_castsi128_si512(descending(_mm512_castsi512_si128(found)));
    if (count > 4) [[unlikely]] {
      alignas(64) u32 key[16], in_order[16];
      _mm512_store_si512(key, found);
      for (u32 i = 0; i < count; ++i) {
        const __m512i one = _mm512_set1_epi32(static_cast<int>(key[i]));
        const u32 farther = _mm512_cmpgt_epu32_mask(found, one);
        in_order[compiler::ones(farther)] = key[i];
      }
      sorted = _mm512_load_si512(in_order);
    }
    const __m512i children = _mm512_permutexvar_epi32(sorted, _mm512_load_si512(node.child));
    if (count > 4) [[unlikely]] {
      _mm512_storeu_si512(near_to, sorted);
      _mm512_storeu_si512(child_to, children);
    } else {
      _mm_storeu_si128(reinterpret_cast<__m128i*>(near_to), _mm512_castsi512_si128(sorted));
      _mm_storeu_si128(reinterpret_cast<__m128i*>(child_to), _mm512_castsi512_si128(children));
    }
    return count;
  }
  // Zeros, which stand for none, come last.
  PH_INLINE static __m128i descending(__m128i a) {
    const __m128i b = _mm_shuffle_epi32(a, 0xb1);  // neighbours exchanged
    a = _mm_blend_epi32(_mm_max_epu32(a, b), _mm_min_epu32(a, b), 0b1010);
    const __m128i c = _mm_shuffle_epi32(a, 0x4e);  // halves exchanged
    a = _mm_blend_epi32(_mm_max_epu32(a, c), _mm_min_epu32(a, c), 0b1100);
    const __m128i d = _mm_shuffle_epi32(a, 0xd8);  // the two in the middle exchanged
    return _mm_blend_epi32(_mm_max_epu32(a, d), _mm_min_epu32(a, d), 0b0100);
  }

  u32* const near_;
  Child* const child_;
  u32 size_ = 0;
};

#else

// What a node leaves behind lies there as a whole, a key or a bit for each of its children, out of
// which the next is picked when it is wanted.
class Stack {
  // By lane how far away a child is, where its number takes the last four bits: the order of floats
  // that are not negative is that of their bits. kTaken where it is met no more.
  struct Near {
    LaneInts key;
    const Node* node;
  };
  static constexpr int kTaken = 0x7fffffff;
  struct Any {
    const Node* node;
    u32 hits;
  };

 public:
  // Each level of nodes leaves at most one behind, and what is put there last may not count.
  struct Room {
    Near near[kMaxTreeDepth + 1];
    Any any[kMaxTreeDepth + 1];
  };
  PH_INLINE explicit Stack(Room& room)
      : first_(room.near), first_any_(room.any), top_(room.near), top_any_(room.any) {}

  // What a walk begins with: the children of one node.
  struct Start {
    LaneInts key;
    const Node* node;
    u32 hits;
  };
  // near: where the ray enters the boxes of those that it hits.
  template <bool kAny>
  PH_INLINE static void prepare(const Node& node, const Lanes& near, const LaneMask& hits,
                                Start& out) {
    if constexpr (!kAny) out.key = keys(near, hits);
    out.node = &node, out.hits = bits(hits);
  }
  // Puts them on an empty stack, but for the next. False if there is none.
  template <bool kAny>
  PH_INLINE bool begin(const Start& start, Child& next) {
    if (start.hits == 0) return false;
    next = kAny ? pick(*start.node, start.hits) : pick(*start.node, start.key, start.hits);
    return true;
  }
  // As these two at once.
  template <bool kAny>
  PH_INLINE bool push(const Node& node, const Lanes& near, const LaneMask& hits, Child& next) {
    const u32 met = bits(hits);
    if (met == 0) return false;
    next = kAny ? pick(node, met) : pick(node, keys(near, hits), met);
    return true;
  }

  // False if there is none.
  PH_INLINE bool pop(Child& child) {
    if (top_any_ == first_any_) return false;
    --top_any_;
    child = pick(*top_any_->node, top_any_->hits);
    return true;
  }
  // The uppermost whose box begins before `limit`.
  PH_INLINE bool pop(Child& child, float limit) {
    const LaneInts beyond = all((__builtin_bit_cast(int, limit) | 15) + 1);
    LaneInts key;
    u32 left = 0;
    do {
      if (top_ == first_) return false;
      key = (--top_)->key;
      left = bits(key < beyond);
    } while (left == 0);
    child = pick(*top_->node, key, left);
    return true;
  }

 private:
  PH_INLINE static LaneInts keys(const Lanes& near, const LaneMask& hits) {
    return select(hits, (whole(near) & all(~15)) | lane_numbers(), all(kTaken));
  }
  // The nearest, of one or more; the others, if there are some, stay on top.
  PH_INLINE Child pick(const Node& node, const LaneInts& key, u32 hits) {
    const LaneInts nearest = least(key);
    *top_ = {select(nearest < key, key, all(kTaken)), &node};
    top_ += (hits & (hits - 1)) != 0 ? 1 : 0;
    return node.child[first(nearest) & 15];
  }
  // The node's last.
  PH_INLINE Child pick(const Node& node, u32 hits) {
    const u32 last = 31 - compiler::leading_zeros(hits), others = hits ^ 1u << last;
    *top_any_ = {&node, others};
    top_any_ += others != 0 ? 1 : 0;
    return node.child[last];
  }

  Near* const first_;
  Any* const first_any_;
  Near* top_;
  Any* top_any_;
};

#endif

}  // namespace parhelion::PH_ISA
