// Building the distributions that core/distribution.h samples.
#pragma once
#include <cstddef>
#include <vector>

#include "../core/distribution.h"
#include "../core/image.h"
#include "array.h"

namespace parhelion {

class DistributionTable {
 public:
  // Weights by rows of up to 65,536 columns and as many rows; those that are not positive and
  // finite count as 0, and if all do, as 1.
  DistributionTable(u32 width, u32 height, const std::vector<double>& weights);

  Distribution view() const {
    return {rows_.data(),         columns_.data(), row_guide_.data(),
            column_guide_.data(), width_,          height_};
  }
  // Of so many weights, about.
  static u64 bytes(u64 weights) { return weights * (sizeof(u32) + sizeof(u16)); }
  std::size_t memory() const {
    return rows_.bytes() + columns_.bytes() + row_guide_.bytes() + column_guide_.bytes();
  }

 private:
  u32 width_, height_;
  Array<u32> rows_, columns_;
  Array<u16> row_guide_, column_guide_;
};

// Of an environment's image, its luminance times solid angle: see core/panorama.h.
DistributionTable latlong_distribution(const ImageView& image);
DistributionTable equal_area_distribution(const ImageView& image);

}  // namespace parhelion
