// What a ray is still to visit of a tree: of nodes that it has been at those children whose boxes
// it meets. Next is the nearest of the last node's, or, where any hit will do, its last.
//
// How many boxes a ray meets, and in which order, cannot be predicted. So what is next is found
// without branches, or with few.
#pragma once
#include "view.h"

namespace parhelion::PH_ISA {

// A level of nodes leaves at most fifteen behind, since one is gone to; the last may write sixteen,
// a whole register.
inline constexpr u32 kStackSize = 15 * kMaxTreeDepth + 1;

#if defined(__AVX512F__)

// Sorted in registers, without branches where no more than four are put there.
template <bool kAny>
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
  // near: where the ray enters the boxes that it meets.
  PH_INLINE static void prepare(const Node& node, const Lanes& near, const LaneMask& met,
                                Start& out) {
    out.count = put(node, near, bits(met), out.near, out.child);
  }
  // Puts them on an empty stack, but for the next. False if there is none.
  PH_INLINE bool begin(const Start& start, Child& next) {
    if (start.count == 0) return false;
    if constexpr (!kAny) _mm512_storeu_si512(near_, _mm512_load_si512(start.near));
    _mm512_storeu_si512(child_, _mm512_load_si512(start.child));
    size_ = start.count - 1;
    next = start.child[size_];
    return true;
  }

  // Puts a node's children there, but for the next. False if that is to be taken from there.
  PH_INLINE bool push(const Node& node, const Lanes& near, const LaneMask& met, Child& next) {
    const u32 hits = bits(met);
    if constexpr (kAny) {
      size_ += put(node, near, hits, near_, child_ + size_);
      return false;
    }
    if ((hits & (hits - 1)) != 0) {
      size_ += put(node, near, hits, near_ + size_, child_ + size_) - 1;
      next = child_[size_];
      return true;
    }
    if (hits != 0) next = node.child[lowest_bit(hits)];  // which need not wait for the stack
    return hits != 0;
  }

  // The next whose box begins before `limit`, where any hit will do whatever that is. False if
  // there is none.
  PH_INLINE bool pop(Child& next, float limit) {
    do {
      if (size_ == 0) return false;
      --size_;
    } while (!kAny && !(__builtin_bit_cast(float, near_[size_] & ~15u) <= limit));
    next = child_[size_];
    return true;
  }

 private:
  // What is next last; returns how many there are.
  PH_INLINE static u32 put(const Node& node, const Lanes& near, u32 hits, u32* near_to,
                           Child* child_to) {
    const u32 count = compiler::ones(hits);
    if constexpr (kAny) {
      const __m512i children = _mm512_load_si512(node.child);
      _mm512_storeu_si512(child_to,
                          _mm512_maskz_compress_epi32(static_cast<__mmask16>(hits), children));
      return count;
    }
    // Of floats that are not negative the order is that of their bits. The last four give way to
    // the child's number, so the distances that are kept are less by that.
    const __m512i numbers = _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    const __m512i distances =
        _mm512_andnot_si512(_mm512_set1_epi32(15), _mm512_castps_si512(near.part[0]));
    const __m512i found = _mm512_maskz_compress_epi32(static_cast<__mmask16>(hits),
                                                      _mm512_or_si512(distances, numbers));
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

// What a node leaves behind: by lane how far away a child is, where the lane's number takes the
// last four bits, as of floats that are not negative the order is that of their bits; kTaken where
// there is none any more. Where any hit will do, a bit for each.
template <bool kAny>
struct Left {
  LaneInts children;
  const Node* node;
};
template <>
struct Left<true> {
  u32 children;
  const Node* node;
};

// It lies there as a whole, and what is next is picked out of it when it is wanted.
template <bool kAny>
class Stack {
  using Children = decltype(Left<kAny>::children);

 public:
  // Each level of nodes leaves one behind at most.
  struct Room {
    Left<kAny> left[kMaxTreeDepth];
  };
  PH_INLINE explicit Stack(Room& room) : first_(room.left), top_(room.left) {}

  // What a walk begins with: the children of one node.
  struct Start {
    Children children;
    const Node* node;
    u32 hits;
  };
  // near: where the ray enters the boxes that it meets.
  PH_INLINE static void prepare(const Node& node, const Lanes& near, const LaneMask& met,
                                Start& out) {
    out.children = children(near, met);
    out.node = &node, out.hits = bits(met);
  }
  // Puts them on an empty stack, but for the next. False if there is none.
  PH_INLINE bool begin(const Start& start, Child& next) {
    if (start.hits == 0) return false;
    next = pick(*start.node, start.children, start.hits);
    return true;
  }

  // Puts a node's children there, but for the next. False if that is to be taken from there.
  PH_INLINE bool push(const Node& node, const Lanes& near, const LaneMask& met, Child& next) {
    const u32 hits = bits(met);
    if (hits == 0) return false;
    next = pick(node, children(near, met), hits);
    return true;
  }

  // The next whose box begins before `limit`, where any hit will do whatever that is. False if
  // there is none.
  PH_INLINE bool pop(Child& next, float limit) {
    Children last;
    u32 hits = 0;
    do {
      if (top_ == first_) return false;
      last = (--top_)->children;
      hits = within(last, limit);
    } while (hits == 0);
    next = pick(*top_->node, last, hits);
    return true;
  }

 private:
  static constexpr int kTaken = 0x7fffffff;

  PH_INLINE static Children children(const Lanes& near, const LaneMask& met) {
    if constexpr (kAny) {
      return bits(met);
    } else {
      return select(met, (whole(near) & all(~15)) | lane_numbers(), all(kTaken));
    }
  }
  PH_INLINE static u32 within(const Children& children, float limit) {
    if constexpr (kAny) {
      return children;
    } else {
      const LaneInts most = all(__builtin_bit_cast(int, limit) | 15);
      return bits(most < children) ^ 0xffffu;
    }
  }
  // What is next of a node's children, of which there are some within the limit, a bit for each;
  // the others, if there are more of these, are on top then. Children go by themselves: within a
  // Left that is copied GCC 12 keeps them in memory, and rays take 1.13 to 1.29 times as long.
  PH_INLINE Child pick(const Node& node, const Children& of, u32 hits) {
    u32 lane;
    if constexpr (kAny) {
      lane = 31 - compiler::leading_zeros(of);
      *top_ = {of ^ 1u << lane, &node};
    } else {
      const LaneInts nearest = least(of);
      lane = static_cast<u32>(first(nearest)) & 15u;
      *top_ = {select(nearest < of, of, all(kTaken)), &node};
    }
    top_ += (hits & (hits - 1)) != 0 ? 1 : 0;
    return node.child[lane];
  }

  Left<kAny>* const first_;
  Left<kAny>* top_;
};

#endif

}  // namespace parhelion::PH_ISA
