// Structs of floats, stored by component: what a loop of a fixed length does with each of them
// compilers turn into vectors, if it has no branches.
#pragma once
#include "simd.h"

namespace parhelion::PH_ISA {

template <class T, u32 kCount>
struct Rows {
  static constexpr u32 kNumbers = sizeof(T) / sizeof(float);

  float row[kNumbers][kCount];

  // By its floats, one by one: a copy of the whole struct would keep loops from becoming vectors.
  // Part: another struct of no more floats, which stands in the first rows.
  template <class Part = T>
  PH_INLINE Part at(u32 i) const {
    static_assert(sizeof(Part) <= sizeof(T));
    Part t;
    float* number = reinterpret_cast<float*>(&t);
    PH_UNROLL for (u32 k = 0; k < sizeof(Part) / sizeof(float); ++k) number[k] = row[k][i];
    return t;
  }
  template <class Part>
  PH_INLINE void set(u32 i, const Part& t) {
    static_assert(sizeof(Part) <= sizeof(T));
    const float* number = reinterpret_cast<const float*>(&t);
    PH_UNROLL for (u32 k = 0; k < sizeof(Part) / sizeof(float); ++k) row[k][i] = number[k];
  }
};

// Slots, stored by component.
template <u32 kCount>
struct SlotRows {
  u32 leaf[kCount], lane[kCount], instance[kCount];

  PH_INLINE Slot at(u32 i) const { return {leaf[i], lane[i], instance[i]}; }
  PH_INLINE void set(u32 i, const Slot& s) {
    leaf[i] = s.leaf, lane[i] = s.lane, instance[i] = s.instance;
  }
};

// Lanes of rows, or of an array, from others'.
template <class T, u32 kCount>
PH_INLINE void move_lanes(Rows<T, kCount>& to, const Rows<T, kCount>& from, const LaneMove& m) {
  for (u32 r = 0; r < Rows<T, kCount>::kNumbers; ++r) move(to.row[r], from.row[r], m);
}
template <u32 kCount>
PH_INLINE void move_lanes(SlotRows<kCount>& to, const SlotRows<kCount>& from, const LaneMove& m) {
  move(to.leaf, from.leaf, m), move(to.lane, from.lane, m), move(to.instance, from.instance, m);
}
template <class T, u32 kCount>
PH_INLINE void move_lanes(T (&to)[kCount], const T (&from)[kCount], const LaneMove& m) {
  move(to, from, m);
}

// One value to lanes of rows, or of an array, that others are moved to.
template <class T, u32 kCount>
PH_INLINE void fill_lanes(Rows<T, kCount>& to, const T& value, const LaneMove& m) {
  const float* number = reinterpret_cast<const float*>(&value);
  for (u32 r = 0; r < Rows<T, kCount>::kNumbers; ++r) fill(to.row[r], number[r], m);
}
template <u32 kCount>
PH_INLINE void fill_lanes(SlotRows<kCount>& to, const Slot& value, const LaneMove& m) {
  fill(to.leaf, value.leaf, m), fill(to.lane, value.lane, m), fill(to.instance, value.instance, m);
}
template <class T, u32 kCount>
PH_INLINE void fill_lanes(T (&to)[kCount], T value, const LaneMove& m) {
  fill(to, value, m);
}
// And to all lanes.
template <class T, u32 kCount>
PH_INLINE void fill_lanes(Rows<T, kCount>& to, const T& value) {
  for (u32 k = 0; k < kCount; ++k) to.set(k, value);
}
template <u32 kCount>
PH_INLINE void fill_lanes(SlotRows<kCount>& to, const Slot& value) {
  for (u32 k = 0; k < kCount; ++k) to.set(k, value);
}
template <class T, u32 kCount>
PH_INLINE void fill_lanes(T (&to)[kCount], T value) {
  for (T& lane : to) lane = value;
}

// One lane of rows from another's.
template <class T, u32 kCount>
PH_INLINE void copy_lane(Rows<T, kCount>& to, u32 k, const Rows<T, kCount>& from, u32 lane) {
  to.set(k, from.at(lane));
}

}  // namespace parhelion::PH_ISA
