// What a ray is still to visit of a tree. Of the children that one node puts there the nearest lies
// on top, or, where any hit will do, the node's last.
#pragma once
#include "view.h"

namespace parhelion::PH_ISA {

// A level of nodes leaves at most fifteen behind, since one is gone to; the last may write sixteen,
// a whole register.
inline constexpr u32 kStackSize = 15 * kMaxTreeDepth + 1;

#if defined(__AVX512F__)

// Sorted in registers, and without branches where no more than four are put there: how many boxes a
// ray meets cannot be predicted.
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
  PH_INLINE static void prepare(const Node& node, const Lanes& near, u32 hits, Start& out) {
    if constexpr (kAny) {
      const __m512i children = _mm512_load_si512(node.child);
      _mm512_store_si512(out.child,
                         _mm512_maskz_compress_epi32(static_cast<__mmask16>(hits), children));
      out.count = compiler::ones(hits);
    } else {
      out.count = order(node, near, hits, out.near, out.child);
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

  // Children of a node, a bit for each in `hits`, of which there are two or more; near: where the
  // ray enters their boxes. Returns the nearest, which is not put there.
  PH_INLINE Child push(const Node& node, const Lanes& near, u32 hits) {
    size_ += order(node, near, hits, near_ + size_, child_ + size_) - 1;
    return child_[size_];
  }
  // In their order in the node. True if `next` is the last, which then is not put there.
  PH_INLINE bool push(const Node& node, u32 hits, Child& /*next*/) {
    _mm512_storeu_si512(child_ + size_, _mm512_maskz_compress_epi32(static_cast<__mmask16>(hits),
                                                                    _mm512_load_si512(node.child)));
    size_ += compiler::ones(hits);
    return false;
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

class Stack {
 public:
  struct Room {
    u64 entry[kStackSize];
  };
  PH_INLINE explicit Stack(Room& room) : first_(room.entry), top_(room.entry) {}

  // Without AVX-512 sorting has branches, and is left to each walk.
  struct Start {
    alignas(64) float near[16];
    const Node* node;
    u32 hits;
  };
  template <bool kAny>
  PH_INLINE static void prepare(const Node& node, const Lanes& near, u32 hits, Start& out) {
    if constexpr (!kAny) store(out.near, near);
    out.node = &node, out.hits = hits;
  }
  template <bool kAny>
  PH_INLINE bool begin(const Start& start, Child& next) {
    if (start.hits == 0) return false;
    if constexpr (kAny) return push(*start.node, start.hits, next);
    next = push(*start.node, load(start.near), start.hits);
    return true;
  }

  PH_INLINE Child push(const Node& node, const Lanes& near, u32 hits) {
    alignas(64) float at[16];
    store(at, near);
    u64* const start = top_;
    for_each_bit(hits, [&](u32 k) {
      // Insertion sort, farthest first: of floats that are not negative the order is that of their
      // bits, which are an entry's upper half.
      const u64 e = static_cast<u64>(__builtin_bit_cast(u32, at[k])) << 32 | node.child[k];
      u64* place = top_++;
      for (; place != start && place[-1] < e; --place) *place = place[-1];
      *place = e;
    });
    return static_cast<Child>(*--top_);
  }
  PH_INLINE bool push(const Node& node, u32 hits, Child& next) {
    if (hits == 0) return false;
    u32 k = lowest_bit(hits);
    while ((hits &= hits - 1) != 0) {
      *top_++ = node.child[k];
      k = lowest_bit(hits);
    }
    next = node.child[k];
    return true;
  }

  PH_INLINE bool pop(Child& child) {
    if (top_ == first_) return false;
    child = static_cast<Child>(*--top_);
    return true;
  }
  PH_INLINE bool pop(Child& child, float limit) {
    do {
      if (top_ == first_) return false;
      --top_;
    } while (!(__builtin_bit_cast(float, static_cast<u32>(*top_ >> 32)) <= limit));
    child = static_cast<Child>(*top_);
    return true;
  }

 private:
  u64* const first_;
  u64* top_;
};

#endif

}  // namespace parhelion::PH_ISA
