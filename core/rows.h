// Structs of floats, stored by component: what a loop of a fixed length does with each of them
// compilers turn into vectors, if it has no branches.
#pragma once
#include "math.h"

namespace parhelion::PH_ISA {

template <class T, u32 kCount>
struct Rows {
  static constexpr u32 kNumbers = sizeof(T) / sizeof(float);

  float row[kNumbers][kCount];

  // By its floats, one by one: a copy of the whole struct would keep loops from becoming vectors.
  PH_INLINE T at(u32 i) const {
    T t;
    float* number = reinterpret_cast<float*>(&t);
    for (u32 k = 0; k < kNumbers; ++k) number[k] = row[k][i];
    return t;
  }
  PH_INLINE void set(u32 i, const T& t) {
    const float* number = reinterpret_cast<const float*>(&t);
    for (u32 k = 0; k < kNumbers; ++k) row[k][i] = number[k];
  }
};

}  // namespace parhelion::PH_ISA
