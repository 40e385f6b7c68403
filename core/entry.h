// How the entries of materials.def, textures.def and lights.def describe themselves: a name, a
// sentence, and a table of parameters from which the schema, the checks and the documentation are
// made.
#pragma once
#include "types.h"

namespace parhelion {

// size 1 is a number, 3 a colour, point or direction. Each value must lie in [low, high].
struct ParamInfo {
  const char* name;
  int size;
  float preset[3];
  float low, high;
  const char* doc;
  // Words separated by '|' if the value is one of them; what is stored is its place, from 0.
  const char* choices = nullptr;
  // The host multiplies the value by (normalised units per user's unit)^length_power: 1 for a
  // length or a point, 2 for an intensity in W/sr, -1 for something per length.
  int length_power = 0;
};

// The parameters of one entry as plain floats, in the order of its table.
inline constexpr int kBlockFloats = 31;
struct ParamBlock {
  u32 kind;
  float value[kBlockFloats];
};

}  // namespace parhelion

namespace parhelion::PH_ISA {

// The entry's own struct from its block.
template <class Entry>
PH_INLINE Entry from_block(const ParamBlock& block) {
  static_assert(sizeof(Entry) <= sizeof(block.value));
  Entry entry;
  compiler::copy(&entry, block.value, sizeof(Entry));
  return entry;
}

// And back.
template <class Entry>
PH_INLINE void to_block(const Entry& entry, ParamBlock& block) {
  compiler::copy(block.value, &entry, sizeof(Entry));
}

}  // namespace parhelion::PH_ISA
