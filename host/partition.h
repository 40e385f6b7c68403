// Dividing in two by what cannot be predicted.
#pragma once
#include <algorithm>
#include <cstddef>
#include <utility>

namespace parhelion {

// Brings those for which `first` is true to the front, where it is known that they will end at
// `middle`. Of those on the wrong side each from the front changes places with the next from the
// back; what order that leaves is the same everywhere, which std::partition does not promise. No
// branch depends on `first`, half of which processors would guess wrong: places are gathered before
// any change. Should `middle` be wrong, it ends all the same, with some on the wrong side.
// Method: S. Edelkamp and A. Weiss, "BlockQuicksort: Avoiding Branch Mispredictions in Quicksort",
// ESA 2016.
template <class T, class First>
void partition(T* from, T* const middle, T* to, First&& first) {
  constexpr std::ptrdiff_t kBlock = 64;
  T *wrong_left[kBlock], *wrong_right[kBlock];
  size_t left = 0, lefts = 0, right = 0, rights = 0;
  for (;;) {
    if (left == lefts) {
      left = lefts = 0;
      for (T* const end = from + std::min(kBlock, middle - from); from != end; ++from) {
        wrong_left[lefts] = from;
        lefts += !first(*from);
      }
    }
    if (right == rights) {
      right = rights = 0;
      for (T* const end = to - std::min(kBlock, to - middle); to != end;) {
        wrong_right[rights] = --to;
        rights += first(*to);
      }
    }
    const size_t pairs = std::min(lefts - left, rights - right);
    for (size_t i = 0; i < pairs; ++i) std::swap(*wrong_left[left++], *wrong_right[right++]);
    if ((left == lefts && from == middle) || (right == rights && to == middle)) return;
  }
}

}  // namespace parhelion
