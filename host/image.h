// Images: from arrays of the usual number types to pyramids that the kernels look up.
#pragma once
#include <string>

#include "../core/image.h"
#include "array.h"

namespace parhelion {

enum class SampleType { uint8, uint16, float16, float32 };

// An array of rows from the top, channels side by side: 1 grey, 2 grey and alpha, 3 RGB, 4 RGB and
// alpha. Integers count from 0 to the largest of their type.
struct ImageInput {
  std::string name;  // for errors
  const void* data;
  SampleType type;
  u32 width, height, channels;
  bool srgb;  // the colours, not alpha, are encoded as in IEC 61966-2-1
  bool mip;   // false: keep the image alone
};

// Owns an image. Bytes are kept as bytes; all else becomes linear float32. Each level is the area
// average of the one above in linear light, so that its mean is the image's; alpha is averaged like
// the colours, which are not multiplied by it.
class ImagePyramid {
 public:
  // Throws SceneError for a size out of range and for numbers that are not finite.
  explicit ImagePyramid(const ImageInput& input);

  ImageView view() const;
  // The least and the greatest linear value of the colours.
  float low() const { return low_; }
  float high() const { return high_; }
  size_t memory() const { return bytes_.bytes() + floats_.bytes(); }

  // Bytes that a pyramid will keep, and those that it takes beside them while it is made.
  struct Needs {
    u64 kept, passing;
  };
  static Needs needs(const ImageInput& input);

 private:
  template <class Sample>
  void read(const ImageInput& input, const Sample* data);
  void read_bytes(const ImageInput& input);
  void reduce();
  void check(const ImageInput& input);

  ImageView view_{};
  Array<u8> bytes_;
  Array<float> floats_;
  float low_ = 0.0f, high_ = 0.0f;
};

}  // namespace parhelion
