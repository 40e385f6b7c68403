// The text of Wavefront OBJ files.
#pragma once
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include "../core/types.h"
#include "blocks.h"

namespace parhelion {

struct ObjStatement {
  u32 polygon;  // how many came before
  std::string word, rest;
};

struct ObjText {
  std::vector<double> positions, uvs, normals;  // three, two and three numbers each
  std::vector<double> colors;                   // three a position, or none at all
  std::vector<u32> sizes;                       // corners of each polygon
  // Position, uv and normal of each corner, from 0; -1 is none. Where no corner has more than a
  // position, only that, and `width` is 1.
  std::vector<int> corners;
  u32 width = 3;
  std::vector<ObjStatement> statements;  // usemtl and mtllib
  std::vector<std::string> unknown;      // words that lines begin with and that mean nothing here
};

// What is wrong with a line; lines count from 1.
struct ObjError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

// Reads v, vt, vn and f lines and the statements above; g, o and s are passed over.
// Every index is in range. Throws ObjError. Threads read blocks of about so many bytes.
ObjText parse_obj(std::string_view text, size_t block = kBlock);

}  // namespace parhelion
