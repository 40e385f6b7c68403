#include "image.h"

#include <algorithm>
#include <limits>
#include <vector>

#include "errors.h"
#include "threads.h"

namespace parhelion {
namespace {

using namespace baseline;

// A number of IEEE 754 binary16.
struct Half {
  unsigned short bits;
};

float half_to_float(Half h) {
  const u32 sign = (h.bits & 0x8000u) << 16, exponent = (h.bits >> 10) & 31u;
  const u32 fraction = h.bits & 0x3ffu;
  if (exponent == 0) {  // 0 and the numbers below 2^-14, in steps of 2^-24
    const float size = static_cast<float>(fraction) * 0x1p-24f;
    return sign != 0 ? -size : size;
  }
  const u32 own = exponent == 31 ? 255u : exponent + 112u;
  return __builtin_bit_cast(float, sign | own << 23 | fraction << 13);
}

float to_float(unsigned short x) { return static_cast<float>(x) / 65535.0f; }
float to_float(Half x) { return half_to_float(x); }
float to_float(float x) { return x; }

float srgb_to_linear(float x) {
  return x <= 0.04045f ? x / 12.92f : pow((x + 0.055f) / 1.055f, 2.4f);
}

float linear_to_srgb(float x) {
  return x <= 0.0031308f ? x * 12.92f : 1.055f * pow(x, 1.0f / 2.4f) - 0.055f;
}

u8 to_byte(float x) { return static_cast<u8>(clamp(x, 0.0f, 1.0f) * 255.0f + 0.5f); }

// The codes of sRGB by search instead of by a power.
class SrgbCodes {
 public:
  SrgbCodes() {
    for (u32 code = 1; code < 256; ++code) {
      u32 low = 0, high = __builtin_bit_cast(u32, 1.0f);  // bits of numbers below it and not
      while (high - low > 1) {
        const u32 middle = low + (high - low) / 2;
        const bool below = to_byte(linear_to_srgb(__builtin_bit_cast(float, middle))) < code;
        (below ? low : high) = middle;
      }
      first_[code] = __builtin_bit_cast(float, high);
    }
    for (u32 i = 0, code = 0; i < kBins; ++i) {
      const float x = static_cast<float>(i) / static_cast<float>(kBins);
      while (code < 255 && first_[code + 1] <= x) ++code;
      guide_[i] = static_cast<u8>(code);
    }
  }

  u8 of(float x) const {
    if (!(x > 0.0f)) return 0;
    u32 code = guide_[std::min(static_cast<u32>(std::min(x, 1.0f) * kBins), kBins - 1)];
    while (code < 255 && first_[code + 1] <= x) ++code;
    return static_cast<u8>(code);
  }

 private:
  static constexpr u32 kBins = 2048;
  float first_[256] = {};  // the least number of each code
  u8 guide_[kBins] = {};   // the code of the least number in each bin of [0, 1)
};

// Which texels of a row or column of n make texel i of the next level, and in what shares: two of
// an even number; of an odd one three, the outer ones in part.
struct Taps {
  u32 first;
  u32 count;
  float share[3];
};

Taps taps(u32 i, u32 n) {
  if (n == 1) return {0, 1, {1.0f, 0.0f, 0.0f}};
  if (n % 2 == 0) return {2 * i, 2, {0.5f, 0.5f, 0.0f}};
  const float whole = static_cast<float>(n), half = static_cast<float>(n / 2);
  const float at = static_cast<float>(i);
  return {2 * i, 3, {(half - at) / whole, half / whole, (at + 1.0f) / whole}};
}

}  // namespace

ImagePyramid::ImagePyramid(const ImageInput& input) {
  const std::string who = "image '" + input.name + "': ";
  if (input.width == 0 || input.height == 0) throw SceneError(who + "has no pixels");
  if (input.width > kMaxImageSide || input.height > kMaxImageSide) {
    throw SceneError(who + "is " + std::to_string(input.width) + " x " +
                     std::to_string(input.height) + " pixels; at most " +
                     std::to_string(kMaxImageSide) + " are allowed on a side");
  }
  if (input.channels < 1 || input.channels > 4) {
    throw SceneError(who + "has " + std::to_string(input.channels) + " channels; 1 to 4 are known");
  }
  view_.width = input.width;
  view_.height = input.height;
  view_.channels = input.channels == 2 ? 4 : input.channels;
  u64 total = 0;
  for (u32 w = input.width, h = input.height;; w = std::max(w / 2, 1u), h = std::max(h / 2, 1u)) {
    view_.first[view_.levels++] = static_cast<u32>(total);
    total += u64{w} * h;
    if (!input.mip || (w == 1 && h == 1)) break;
  }
  if (total > std::numeric_limits<u32>::max()) {
    throw SceneError(who + "has " + std::to_string(u64{input.width} * input.height) +
                     " pixels, more than can be kept");
  }
  if (input.type == SampleType::uint8) {
    view_.format = input.srgb ? ImageFormat::srgb8 : ImageFormat::linear8;
    bytes_ = Array<u8>(total * view_.channels);
    view_.texels = bytes_.data();
  } else {
    view_.format = ImageFormat::float32;
    floats_ = Array<float>(total * view_.channels);
    view_.texels = floats_.data();
  }
  switch (input.type) {
    case SampleType::uint8: read_bytes(input); break;
    case SampleType::uint16: read(input, static_cast<const unsigned short*>(input.data)); break;
    case SampleType::float16: read(input, static_cast<const Half*>(input.data)); break;
    case SampleType::float32: read(input, static_cast<const float*>(input.data)); break;
  }
  check(input);
  if (input.mip) reduce();
}

ImagePyramid::Needs ImagePyramid::needs(const ImageInput& input) {
  const u64 channels = input.channels == 2 ? 4 : input.channels;
  u64 texels = u64{input.width} * input.height, below = 0;
  if (input.mip) {
    for (u32 w = input.width, h = input.height; w > 1 || h > 1;) {
      w = std::max(w / 2, 1u), h = std::max(h / 2, 1u);
      texels += u64{w} * h;
      if (below == 0) below = u64{w} * h;
    }
  }
  const u64 size = input.type == SampleType::uint8 ? sizeof(u8) : sizeof(float);
  // The second level in float, and the third beside it.
  return {texels * channels * size, (below + below / 4) * channels * sizeof(float)};
}

ImageView ImagePyramid::view() const {
  ImageView v = view_;
  v.texels = bytes_.empty() ? static_cast<const void*>(floats_.data()) : bytes_.data();
  return v;
}

void ImagePyramid::read_bytes(const ImageInput& input) {
  const u8* data = static_cast<const u8*>(input.data);
  const size_t texels = size_t{input.width} * input.height;
  if (input.channels != 2) {
    std::copy(data, data + texels * input.channels, bytes_.begin());
    return;
  }
  for (size_t i = 0; i < texels; ++i) {
    const u8 grey = data[2 * i], alpha = data[2 * i + 1];
    const u8 rgba[4] = {grey, grey, grey, alpha};
    std::copy(rgba, rgba + 4, bytes_.begin() + static_cast<std::ptrdiff_t>(4 * i));
  }
}

template <class Sample>
void ImagePyramid::read(const ImageInput& input, const Sample* data) {
  const i64 texels = i64{input.width} * input.height;
  const u32 in = input.channels, out = view_.channels;
#pragma omp parallel for schedule(static) if (texels > i64{kFewElements})
  for (i64 i = 0; i < texels; ++i) {
    const Sample* from = data + i * in;
    float* to = floats_.data() + i * out;
    for (u32 c = 0; c < out; ++c) {
      // of grey and alpha, the first three are grey
      const float x = to_float(in == 2 ? from[c < 3 ? 0 : 1] : from[c]);
      to[c] = input.srgb && c < 3 ? srgb_to_linear(x) : x;
    }
  }
}

// Finds what is not finite, and the range of the colours.
void ImagePyramid::check(const ImageInput& input) {
  const i64 texels = i64{input.width} * input.height;
  const ImageView image = view();
  float low = kInfinity, high = -kInfinity;
  if (!bytes_.empty()) {
    const u32 channels = view_.channels, colors = std::min(channels, 3u);
    u8 least = 255, most = 0;
#pragma omp parallel for schedule(static) reduction(min : least) \
    reduction(max : most) if (texels > i64{kFewElements})
    for (i64 i = 0; i < texels; ++i) {
      for (u32 k = 0; k < colors; ++k) {
        const u8 c = bytes_[static_cast<size_t>(i * channels + k)];
        least = std::min(least, c), most = std::max(most, c);
      }
    }
    const float* value = input.srgb ? kBytes.srgb : kBytes.plain;
    low_ = value[least], high_ = value[most];
    return;
  }
  i64 bad = texels;
#pragma omp parallel for schedule(static) reduction(min : low, bad) \
    reduction(max : high) if (texels > i64{kFewElements})
  for (i64 i = 0; i < texels; ++i) {
    const u32 x = static_cast<u32>(i % input.width), y = static_cast<u32>(i / input.width);
    const Texel t = fetch(image, 0, x, y);
    if (!finite(t.rgb) || !finite(t.a)) bad = std::min(bad, i);
    low = std::min({low, t.rgb.x, t.rgb.y, t.rgb.z});
    high = std::max({high, t.rgb.x, t.rgb.y, t.rgb.z});
  }
  if (bad < texels) {
    throw SceneError("image '" + input.name + "': the pixel in row " +
                     std::to_string(bad / input.width) + ", column " +
                     std::to_string(bad % input.width) + " is not finite");
  }
  low_ = low;
  high_ = high;
}

// Every level from the one above it. `above` keeps that one as it was before it was cut to bytes.
void ImagePyramid::reduce() {
  const ImageView image = view();
  const u32 channels = image.channels;
  static const SrgbCodes codes;
  std::vector<float> above, level;
  for (u32 l = 1; l < image.levels; ++l) {
    const u32 from_w = level_side(image.width, l - 1), from_h = level_side(image.height, l - 1);
    const u32 w = level_side(image.width, l), h = level_side(image.height, l);
    level.assign(size_t{w} * h * channels, 0.0f);
#pragma omp parallel for schedule(static) if (i64{w} * h > i64{kFewElements})
    for (i64 y = 0; y < i64{h}; ++y) {
      const Taps rows = taps(static_cast<u32>(y), from_h);
      for (u32 x = 0; x < w; ++x) {
        const Taps columns = taps(x, from_w);
        const size_t at = (static_cast<size_t>(y) * w + x) * channels;
        float* sum = level.data() + at;
        for (u32 j = 0; j < rows.count; ++j) {
          for (u32 i = 0; i < columns.count; ++i) {
            const u32 from_x = columns.first + i, from_y = rows.first + j;
            const float share = rows.share[j] * columns.share[i];
            if (l == 1) {
              const Texel t = fetch(image, 0, from_x, from_y);
              const float c[4] = {t.rgb.x, t.rgb.y, t.rgb.z, t.a};
              for (u32 k = 0; k < channels; ++k) sum[k] += share * c[k];
            } else {
              const float* c = above.data() + (size_t{from_y} * from_w + from_x) * channels;
              for (u32 k = 0; k < channels; ++k) sum[k] += share * c[k];
            }
          }
        }
        const size_t to = size_t{image.first[l]} * channels + at;
        for (u32 k = 0; k < channels; ++k) {
          if (image.format == ImageFormat::float32) {
            floats_[to + k] = sum[k];
          } else {
            const bool encoded = image.format == ImageFormat::srgb8 && k < 3;
            bytes_[to + k] = encoded ? codes.of(sum[k]) : to_byte(sum[k]);
          }
        }
      }
    }
    above.swap(level);
  }
}

}  // namespace parhelion
