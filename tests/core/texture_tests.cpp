// Images and textures against their definitions, without Python, for the sanitizers to watch.
#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "../../core/image_batch.h"
#include "../../core/texture.h"
#include "../../host/errors.h"
#include "../../host/image.h"
#include "check.h"

namespace {

using namespace parhelion;
namespace ph = parhelion::baseline;

// Uniform in [0, 1), by a linear congruence.
double draw() {
  static u64 state = 1;
  state = state * 6364136223846793005ull + 1442695040888963407ull;
  return static_cast<double>(state >> 40) * 0x1p-24;
}

bool near(double a, double b, double tolerance) { return std::abs(a - b) <= tolerance; }

TextureRecord record(TextureKind kind, std::vector<float> values) {
  TextureRecord r{};
  r.block.kind = static_cast<u32>(kind);
  std::copy(values.begin(), values.end(), r.block.value);
  r.to_uv[0] = r.to_uv[4] = 1.0f;
  r.uvs = kNone;
  return r;
}

constexpr auto no_attribute = [](u32) { return Texel{{0, 0, 0}, 1}; };

Texel look(const TextureRecord& r, const ImageView* image, float u, float v, float width = 0.0f) {
  return ph::evaluate({&r, nullptr, image}, 0, {{u, v}, width, {0, 0, 0}}, no_attribute);
}

std::string message_of(const ImageInput& input) {
  try {
    const ImagePyramid image(input);
  } catch (const SceneError& e) {
    return e.what();
  }
  return "";
}

constexpr float kMip = 0, kBilinear = 1, kNearest = 2, kRepeat = 0, kMirror = 1, kClamp = 2,
                kZero = 3;

// Of two texels in sRGB, the mean of their light, in the nearest code.
void encoded_texels_are_mixed_as_light() {
  const auto decoded = [](double c) {
    return c <= 0.04045 ? c / 12.92 : std::pow((c + 0.055) / 1.055, 2.4);
  };
  const auto encoded = [](double x) {
    return x <= 0.0031308 ? x * 12.92 : 1.055 * std::pow(x, 1.0 / 2.4) - 0.055;
  };
  for (int a = 0; a < 256; ++a) {
    for (int b = a; b < 256; ++b) {
      const u8 bytes[] = {static_cast<u8>(a), static_cast<u8>(b)};
      const ImagePyramid image({"a", bytes, SampleType::uint8, 2, 1, 1, true, true});
      const ImageView view = image.view();
      const double mean = encoded(0.5 * (decoded(a / 255.0) + decoded(b / 255.0))) * 255.0;
      const double found = static_cast<const u8*>(view.texels)[view.first[1]];
      CHECK(std::abs(found - mean) < 0.5 + 1e-4);
    }
  }
}

// Every level of a pyramid has the image's mean in linear light, whatever its size and type; its
// range is that of the colours, without alpha.
void pyramids_keep_the_mean() {
  for (const auto& [w, h] :
       {std::pair{16u, 16u}, {13u, 9u}, {1u, 7u}, {257u, 3u}, {1u, 1u}, {96u, 65u}}) {
    for (u32 channels : {1u, 2u, 3u, 4u}) {
      const bool alpha = channels % 2 == 0;
      std::vector<float> floats(size_t{w} * h * channels);
      for (float& x : floats) x = static_cast<float>(draw() * 0.8 + 0.1);
      std::vector<u8> bytes(floats.size());
      for (u8& x : bytes) x = static_cast<u8>(draw() * 200.0 + 20.0);
      if (alpha) {  // out of the range of colours
        floats[channels - 1] = 0.0f, floats.back() = 1.0f;
        bytes[channels - 1] = 0, bytes.back() = 255;
      }
      for (bool byte : {false, true}) {
        const void* data = byte ? static_cast<const void*>(bytes.data()) : floats.data();
        const ImagePyramid image({"a", data, byte ? SampleType::uint8 : SampleType::float32, w, h,
                                  channels, true, true});
        const ImageView view = image.view();
        CHECK(ph::level_side(w, view.levels - 1) == 1 && ph::level_side(h, view.levels - 1) == 1);
        double mean = 0.0, mean_alpha = 0.0;
        float low = kInfinity, high = 0.0f;
        for (u32 y = 0; y < h; ++y) {
          for (u32 x = 0; x < w; ++x) {
            const Texel t = ph::fetch(view, 0, x, y);
            mean += static_cast<double>(t.rgb.y) / (w * h);
            mean_alpha += static_cast<double>(t.a) / (w * h);
            low = std::min({low, t.rgb.x, t.rgb.y, t.rgb.z});
            high = std::max({high, t.rgb.x, t.rgb.y, t.rgb.z});
          }
        }
        const Texel last = ph::fetch(view, view.levels - 1, 0, 0);
        // a byte of sRGB is at most 0.009 from the next in linear light
        CHECK(near(static_cast<double>(last.rgb.y), mean, byte ? 0.0045 : 1e-5));
        CHECK(near(static_cast<double>(last.a), mean_alpha, byte ? 0.002 : 1e-5));
        CHECK(image.low() == low && image.high() == high);
      }
    }
  }
}

// Whoever divides the work, what is not finite is found, the first of it.
void what_is_not_finite_is_found_in_large_images() {
  for (const u32 channels : {1u, 3u, 4u}) {
    for (const size_t at : {size_t{0}, size_t{5000}, size_t{128 * 96 - 1}}) {
      std::vector<float> texels(size_t{128} * 96 * channels, 0.5f);
      texels.back() = kInfinity;
      texels[at * channels] = ph::kNan;
      const std::string told =
          message_of({"a", texels.data(), SampleType::float32, 128, 96, channels, false, true});
      CHECK(told == "image 'a': the pixel in row " + std::to_string(at / 128) + ", column " +
                        std::to_string(at % 128) + " is not finite");
    }
  }
}

// Of large images samples of two bytes are decoded by a table: to what small ones have.
void large_images_are_decoded_alike() {
  constexpr u32 kWidth = 512, kHeight = 160, kChannels = 4;
  std::vector<unsigned short> samples(size_t{kWidth} * kHeight * kChannels);
  for (unsigned short& x : samples) x = static_cast<unsigned short>(draw() * 0x7c00);  // finite
  for (SampleType type : {SampleType::uint16, SampleType::float16}) {
    const ImagePyramid large({"a", samples.data(), type, kWidth, kHeight, kChannels, true, false});
    for (u32 y = 0; y < kHeight; ++y) {
      const void* row = samples.data() + size_t{y} * kWidth * kChannels;
      const ImagePyramid small({"a", row, type, kWidth, 1, kChannels, true, false});
      const auto* one = static_cast<const float*>(large.view().texels) + y * kWidth * kChannels;
      const auto* other = static_cast<const float*>(small.view().texels);
      CHECK(std::equal(one, one + kWidth * kChannels, other));
    }
  }
}

// Code 128 of sRGB is 0.21586 of the light of code 255; alpha is not encoded.
void encodings() {
  const u8 bytes[4] = {0, 128, 255, 128};
  const ImagePyramid encoded({"a", bytes, SampleType::uint8, 1, 1, 4, true, false});
  const Texel t = ph::fetch(encoded.view(), 0, 0, 0);
  CHECK(t.rgb.x == 0.0f && t.rgb.z == 1.0f && near(static_cast<double>(t.rgb.y), 0.2158605, 1e-6));
  CHECK(t.a == 128.0f / 255.0f);
  const ImagePyramid linear({"a", bytes, SampleType::uint8, 2, 2, 1, false, false});
  CHECK(ph::fetch(linear.view(), 0, 1, 0).rgb.y == 128.0f / 255.0f);
  const ImagePyramid pair({"a", bytes, SampleType::uint8, 1, 2, 2, false, false});
  const Texel p = ph::fetch(pair.view(), 0, 0, 1);
  CHECK(p.rgb.x == 1.0f && p.rgb.z == 1.0f && p.a == 128.0f / 255.0f);
  const float grey_alpha[2] = {0.25f, 0.5f};
  const ImagePyramid mixed({"a", grey_alpha, SampleType::float32, 1, 1, 2, true, false});
  const Texel m = ph::fetch(mixed.view(), 0, 0, 0);  // 0.25 of sRGB is 0.0508761
  CHECK(near(static_cast<double>(m.rgb.x), 0.0508761, 1e-6) && m.rgb.y == m.rgb.x);
  CHECK(m.rgb.z == m.rgb.x && m.a == 0.5f);
  // 1, -2, the least number above 0 and 65504 of binary16
  const unsigned short halves[4] = {0x3c00, 0xc000, 0x0001, 0x7bff};
  const ImagePyramid half({"a", halves, SampleType::float16, 4, 1, 1, false, false});
  const float wanted[4] = {1.0f, -2.0f, 0x1p-24f, 65504.0f};
  for (u32 x = 0; x < 4; ++x) CHECK(ph::fetch(half.view(), 0, x, 0).rgb.x == wanted[x]);
  CHECK(half.low() == -2.0f && half.high() == 65504.0f);
  const unsigned short words[2] = {65535, 13107};
  const ImagePyramid word({"a", words, SampleType::uint16, 2, 1, 1, false, false});
  CHECK(ph::fetch(word.view(), 0, 0, 0).rgb.x == 1.0f &&
        ph::fetch(word.view(), 0, 1, 0).rgb.x == 0.2f);
}

// Texel (x, y) of a w by h image is at u = (x + 1/2) / w, v = 1 - (y + 1/2) / h.
void places_and_borders() {
  const float rows[8] = {0, 1, 2, 3, 10, 11, 12, 13};  // the first row is the top
  const ImagePyramid image({"a", rows, SampleType::float32, 4, 2, 1, false, true});
  const ImageView view = image.view();
  const auto at = [&](float filter, float wrap, float u, float v) {
    return look(record(TextureKind::image, {filter, wrap, wrap}), &view, u, v).rgb.x;
  };
  for (float filter : {kMip, kBilinear, kNearest}) {
    CHECK(at(filter, kRepeat, 0.125f, 0.75f) == 0.0f);
    CHECK(at(filter, kRepeat, 0.875f, 0.25f) == 13.0f);
  }
  CHECK(at(kBilinear, kClamp, 0.25f, 0.75f) == 0.5f);  // halfway between two texels
  CHECK(at(kBilinear, kClamp, 0.125f, 0.5f) == 5.0f);  // and between two rows
  CHECK(at(kBilinear, kRepeat, 0.0f, 0.75f) == 1.5f);  // 3 and 0
  CHECK(at(kBilinear, kMirror, 0.0f, 0.75f) == 0.0f);  // 0 and its mirror image
  CHECK(at(kBilinear, kZero, 0.0f, 0.75f) == 0.0f && at(kBilinear, kZero, 1.0f, 0.75f) == 1.5f);
  CHECK(at(kNearest, kRepeat, 1.3f, 0.75f) == 1.0f && at(kNearest, kMirror, 1.3f, 0.75f) == 2.0f);
  CHECK(at(kNearest, kClamp, 1.3f, 0.75f) == 3.0f && at(kNearest, kZero, 1.3f, 0.75f) == 0.0f);
  CHECK(at(kNearest, kMirror, -0.1f, 1.9f) == 10.0f);
  for (float filter : {kMip, kBilinear, kNearest}) {
    for (float wrap : {kRepeat, kMirror, kClamp, kZero}) {
      for (float u : {1e30f, -1e30f, kInfinity, -kInfinity, ph::kNan}) {
        const float x = at(filter, wrap, u, u);
        CHECK(x >= 0.0f && x <= 13.0f);
      }
    }
  }
}

// A footprint of the whole image sees its mean; one of 2^l texels sees level l.
void footprints() {
  std::vector<float> texels(64 * 64);
  double mean = 0.0;
  for (float& x : texels) mean += static_cast<double>(x = static_cast<float>(draw())) / 4096.0;
  const ImagePyramid image({"a", texels.data(), SampleType::float32, 64, 64, 1, false, true});
  const ImageView view = image.view();
  const TextureRecord mip = record(TextureKind::image, {kMip, kRepeat, kRepeat});
  CHECK(near(static_cast<double>(look(mip, &view, 0.3f, 0.8f, 1.0f).rgb.x), mean, 1e-5));
  CHECK(near(static_cast<double>(look(mip, &view, 0.3f, 0.8f, 1e9f).rgb.x), mean, 1e-5));
  const float at_level = ph::bilinear(view, 2, {0.3f, 0.8f}, Wrap::repeat, Wrap::repeat).rgb.x;
  CHECK(look(mip, &view, 0.3f, 0.8f, 4.0f / 64.0f).rgb.x == at_level);
  // scaled uv: the footprint grows with it
  TextureRecord scaled = mip;
  scaled.to_uv[0] = scaled.to_uv[4] = 4.0f;
  CHECK(look(scaled, &view, 0.075f, 0.2f, 1.0f / 64.0f).rgb.x == at_level);
}

// Images of all formats, sizes and borders, looked up many at once: each as by itself, to the bit.
void many_images_at_once() {
  struct Lookup {
    const ImageView* image;
    Vec2 uv;
    float width;
    Wrap wrap_u, wrap_v;
  };
  std::vector<ImagePyramid> images;
  std::vector<u8> bytes(40 * 23 * 4);
  for (u8& b : bytes) b = static_cast<u8>(draw() * 256.0);
  std::vector<float> floats(bytes.size());
  for (float& x : floats) x = static_cast<float>(8.0 * draw() - 4.0);
  for (const auto& [w, h] : {std::pair{40u, 23u}, {16u, 16u}, {1u, 5u}, {7u, 1u}, {1u, 1u}}) {
    for (u32 channels : {1u, 2u, 3u, 4u}) {
      for (bool mip : {false, true}) {
        images.emplace_back(
            ImageInput{"a", floats.data(), SampleType::float32, w, h, channels, false, mip});
        for (bool srgb : {false, true}) {
          images.emplace_back(
              ImageInput{"a", bytes.data(), SampleType::uint8, w, h, channels, srgb, mip});
        }
      }
    }
  }
  std::vector<ImageView> views;
  for (const ImagePyramid& image : images) views.push_back(image.view());
  const float far[] = {0.0f, 1.0f, -1.0f, 0.5f, 1e7f, -3e9f, kInfinity, -kInfinity, ph::kNan};
  const auto place = [&] {
    if (draw() < 0.1) return far[static_cast<size_t>(draw() * 9.0)];
    return static_cast<float>((draw() < 0.5 ? 1.0 : 8.0) * (draw() - 0.3));
  };
  const auto wrap = [] { return static_cast<Wrap>(draw() * 4.0); };
  bool same = true;
  for (int round = 0; round < 4000; ++round) {
    ph::ImageBatch<16> batch;
    Lookup lookups[16];
    const u32 n = 1 + static_cast<u32>(draw() * 16.0);
    for (u32 k = 0; k < n; ++k) {
      const float width = draw() < 0.2 ? far[static_cast<size_t>(draw() * 9.0)]
                                       : static_cast<float>(std::exp2(8.0 * draw() - 7.0));
      lookups[k] = {&views[static_cast<size_t>(draw() * static_cast<double>(views.size()))],
                    {place(), place()},
                    width,
                    wrap(),
                    wrap()};
      const Lookup& l = lookups[k];
      batch.set(k, *l.image, l.uv, l.width, l.wrap_u, l.wrap_v);
    }
    u32 found = 0;
    batch.look(n, [&](u32 k, const Texel& t) {
      const Lookup& l = lookups[k];
      const Texel own = ph::trilinear(*l.image, l.uv, l.width, l.wrap_u, l.wrap_v);
      same &= k == found++ && own.a == t.a && own.rgb.x == t.rgb.x && own.rgb.y == t.rgb.y &&
              own.rgb.z == t.rgb.z;
    });
    same &= found == n;
  }
  CHECK(same);
}

// The filtered checkerboard against a sum over the footprint.
void checkerboards() {
  const TextureRecord r = record(TextureKind::checker, {1, 1, 1, 0, 0, 0, 0});
  CHECK(look(r, nullptr, 0.2f, 0.3f).rgb.x == 1.0f && look(r, nullptr, 0.7f, 0.3f).rgb.x == 0.0f);
  CHECK(look(r, nullptr, -0.2f, 0.3f).rgb.x == 0.0f && look(r, nullptr, -0.2f, 9.7f).rgb.x == 1.0f);
  const auto wave = [](double x) { return x - std::floor(x) <= 0.5 ? 1.0 : -1.0; };
  for (double width : {0.03, 0.3, 0.5, 0.8, 2.7}) {
    for (int i = 0; i < 50; ++i) {
      const float u = static_cast<float>(4.0 * draw() - 2.0), v = static_cast<float>(4.0 * draw());
      double sum_u = 0.0, sum_v = 0.0;
      constexpr int n = 4000;
      for (int k = 0; k < n; ++k) {
        const double offset = width * ((k + 0.5) / n - 0.5);
        sum_u += wave(static_cast<double>(u) + offset) / n;
        sum_v += wave(static_cast<double>(v) + offset) / n;
      }
      const float got = look(r, nullptr, u, v, static_cast<float>(width)).rgb.x;
      CHECK(near(static_cast<double>(got), 0.5 + 0.5 * sum_u * sum_v, 1e-3));
    }
  }
}

void ramps_and_noise() {
  const TextureRecord linear = record(TextureKind::ramp, {0, 0, 0, 1, 2, 4, 0});
  CHECK(look(linear, nullptr, 0.25f, 9.0f).rgb.y == 0.5f &&
        look(linear, nullptr, 3.0f, 0.0f).rgb.z == 4.0f);
  const TextureRecord smooth = record(TextureKind::ramp, {0, 0, 0, 1, 1, 1, 1});
  CHECK(look(smooth, nullptr, 0.25f, 0.0f).rgb.x == 0.15625f);
  const TextureRecord noise =
      record(TextureKind::noise, {0, 0, 0, 1, 1, 1, 0.5f, 5, 0.5f, 0, 1, 3});
  double sum = 0.0, square = 0.0;
  constexpr int n = 20000;
  for (int i = 0; i < n; ++i) {
    const float u = static_cast<float>(200.0 * draw() - 100.0),
                v = static_cast<float>(200.0 * draw());
    const float x = look(noise, nullptr, u, v).rgb.x;
    CHECK(x >= 0.0f && x <= 1.0f);
    sum += static_cast<double>(x) / n;
    square += static_cast<double>(x * x) / n;
  }
  CHECK(near(sum, 0.5, 0.01) && std::sqrt(square - sum * sum) > 0.1);
  // smooth, also across 0, and gone where a pixel sees many blotches
  for (float u = -1.0f; u < 1.0f; u += 0x1p-10f) {
    CHECK(near(static_cast<double>(look(noise, nullptr, u, 0.3f).rgb.x),
               static_cast<double>(look(noise, nullptr, u + 0x1p-10f, 0.3f).rgb.x), 0.02));
  }
  CHECK(look(noise, nullptr, 0.3f, 0.4f, 0.5f).rgb.x == 0.5f);
  CHECK(ph::finite(look(noise, nullptr, kInfinity, ph::kNan).rgb));
}

// Slopes against what is known of them.
void slopes() {
  const auto grey = [](const Texel& t) { return t.rgb.x; };
  const auto slope = [&](const TextureRecord& r, const ImageView* image, TexturePoint p) {
    return ph::slope({&r, nullptr, image}, 0, p, {2, 0, 0}, {0, 3, 0}, grey, no_attribute);
  };
  TextureRecord ramp = record(TextureKind::ramp, {0, 0, 0, 1, 1, 1, 0});
  ramp.to_uv[0] = 0.0f, ramp.to_uv[1] = 0.5f;  // the texture's u is half of v
  const Vec2 s = slope(ramp, nullptr, {{0.3f, 0.6f}, 0.0f, {0, 0, 0}});
  CHECK(s.x == 0.0f && near(static_cast<double>(s.y), 0.5, 1e-4));
  std::vector<float> texels(16 * 16);
  for (size_t i = 0; i < texels.size(); ++i) texels[i] = static_cast<float>(i % 16) * 0.1f;
  const ImagePyramid image({"a", texels.data(), SampleType::float32, 16, 16, 1, false, true});
  const ImageView view = image.view();
  for (float filter : {kMip, kBilinear}) {
    const Vec2 d = slope(record(TextureKind::image, {filter, kRepeat, kRepeat}), &view,
                         {{0.5f, 0.4f}, 0.0f, {0, 0, 0}});
    CHECK(near(static_cast<double>(d.x), 1.6, 1e-3) && d.y == 0.0f);
  }
  // solid noise moves with the surface: 2 scene units per u, 3 per v
  const TextureRecord noise = record(TextureKind::noise, {0, 0, 0, 1, 1, 1, 1, 1, 0.5f, 0, 0, 0});
  const Vec3 at = {0.3f, 0.4f, 0.6f};
  const auto value = [&](float dx, float dy) {
    return static_cast<double>(ph::evaluate({&noise, nullptr, nullptr}, 0,
                                            {{0, 0}, 0.0f, {at.x + dx, at.y + dy, at.z}},
                                            no_attribute)
                                   .rgb.x);
  };
  const Vec2 n = slope(noise, nullptr, {{0, 0}, 0.0f, at});
  constexpr float h = 0x1p-7f;
  CHECK(near(static_cast<double>(n.x), (value(h, 0) - value(-h, 0)) * 64.0 * 2.0, 0.01));
  CHECK(near(static_cast<double>(n.y), (value(0, h) - value(0, -h)) * 64.0 * 3.0, 0.01));
  CHECK(std::abs(n.x) > 0.05f && std::abs(n.y) > 0.05f);
}

void bad_images() {
  const float bad[6] = {1, 2, 3, 4, ph::kNan, kInfinity};
  const auto message = [&](u32 w, u32 h, u32 channels) {
    return message_of({"wood", bad, SampleType::float32, w, h, channels, false, true});
  };
  CHECK(message(3, 2, 1) == "image 'wood': the pixel in row 1, column 1 is not finite");
  CHECK(message(2, 2, 1).empty());
  CHECK(message(0, 2, 1) == "image 'wood': has no pixels");
  CHECK(message(1, 1, 5) == "image 'wood': has 5 channels; 1 to 4 are known");
  CHECK(message(65537, 1, 1).find("is 65537 x 1 pixels; at most 65536") != std::string::npos);
  CHECK(message(65536, 65536, 1).find("more than can be kept") != std::string::npos);
}

}  // namespace

int main() {
  encoded_texels_are_mixed_as_light();
  pyramids_keep_the_mean();
  large_images_are_decoded_alike();
  what_is_not_finite_is_found_in_large_images();
  encodings();
  places_and_borders();
  footprints();
  many_images_at_once();
  checkerboards();
  ramps_and_noise();
  slopes();
  bad_images();
  std::printf(failures == 0 ? "textures: ok\n" : "textures: %d failures\n", failures);
  return failures != 0;
}
