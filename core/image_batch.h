// Between texels of images, many at once: what `trilinear` says, to the bit.
#pragma once
#include "image.h"
#include "rows.h"

namespace parhelion::PH_ISA {

// Images by lane, and where to look them up.
template <u32 kCount>
struct ImagePlaces {
  float u[kCount], v[kCount], width[kCount];
  int columns[kCount], rows[kCount], levels[kCount];
  Wrap wrap_u[kCount], wrap_v[kCount];
};

// The four texels of a level around a place: their numbers in the level by row and column, kNone
// where there is none, and how far the place is from the first.
template <u32 kCount>
struct TexelsAround {
  u32 number[2][2][kCount];
  float right[kCount], down[kCount];
};

template <u32 kCount>
struct ImageBatch {
  const ImageView* image[kCount];
  ImagePlaces<kCount> places = {};

  PH_INLINE void set(u32 k, const ImageView& from, Vec2 uv, float width, Wrap wrap_u, Wrap wrap_v) {
    image[k] = &from;
    places.u[k] = uv.x, places.v[k] = uv.y, places.width[k] = width;
    places.columns[k] = static_cast<int>(from.width);
    places.rows[k] = static_cast<int>(from.height);
    places.levels[k] = static_cast<int>(from.levels);
    places.wrap_u[k] = wrap_u, places.wrap_v[k] = wrap_v;
  }

  // Calls f(lane, texel) for the first n lanes.
  template <class F>
  PH_INLINE void look(u32 n, F&& f) const {
    u32 level[kCount];
    float share[kCount];
    TexelsAround<kCount> fine, coarse;
    find_levels(places, level, share);
    find_texels(places, level, 0, fine);
    find_texels(places, level, 1, coarse);
    for (u32 k = 0; k < n; ++k) {
      with_texels(*image[k], [&](auto&& texel) {
        const auto between = [&](const TexelsAround<kCount>& at, u32 l) {
          const u64 first = image[k]->first[l];
          const auto read = [&](u32 number) {
            return number == kNone ? quad(0.0f, 0.0f, 0.0f, 0.0f) : texel(first + number);
          };
          const auto row = [&](u32 y) {
            return mix(read(at.number[y][0][k]), read(at.number[y][1][k]), at.right[k]);
          };
          const Quad upper = row(0);
          return mix(upper, row(1), at.down[k]);
        };
        Quad sum = between(fine, level[k]);
        if (share[k] > 0.0f) sum = mix(sum, between(coarse, level[k] + 1), share[k]);
        f(k, to_texel(sum));
      });
    }
  }

 private:
  PH_APART static void find_levels(const ImagePlaces<kCount>& __restrict at,
                                   u32 (&__restrict level)[kCount],
                                   float (&__restrict share)[kCount]) {
    // In loops of their own: compilers would make branches for what bounds make constant.
    float texels[kCount], place[kCount];
    for (u32 k = 0; k < kCount; ++k) {
      const float columns = static_cast<float>(at.columns[k]);
      const float rows = static_cast<float>(at.rows[k]);
      // The last level's number is below 17, so 2^20 stands for all that is larger.
      texels[k] = min(max(at.width[k] * max(columns, rows), 1.0f), 0x1p20f);
    }
    for (u32 k = 0; k < kCount; ++k) place[k] = log2_within(texels[k]);
    for (u32 k = 0; k < kCount; ++k) {
      // Lanes that no lookup has been set for have no level.
      const float last = static_cast<float>(at.levels[k] - 1);
      const float there = max(min(place[k], last), 0.0f);
      const int whole = static_cast<int>(there);
      level[k] = static_cast<u32>(whole);
      share[k] = there - static_cast<float>(whole);
    }
  }

  PH_APART static void find_texels(const ImagePlaces<kCount>& __restrict at,
                                   const u32 (&__restrict level)[kCount], u32 add,
                                   TexelsAround<kCount>& __restrict out) {
    for (u32 k = 0; k < kCount; ++k) {
      const u32 l = level[k] + add;
      const int narrow = at.columns[k] >> l, low = at.rows[k] >> l;
      const int w = narrow > 0 ? narrow : 1, h = low > 0 ? low : 1;
      const TexelPair x = texels_around(at.u[k], w, at.wrap_u[k]);
      const TexelPair y = texels_around(1.0f - at.v[k], h, at.wrap_v[k]);
      const auto number = [&](int column, int row) {
        const u32 none = static_cast<u32>((column | row) >> 31);
        return none | (static_cast<u32>(row) * static_cast<u32>(w) + static_cast<u32>(column));
      };
      out.number[0][0][k] = number(x.first, y.first);
      out.number[0][1][k] = number(x.second, y.first);
      out.number[1][0][k] = number(x.first, y.second);
      out.number[1][1][k] = number(x.second, y.second);
      out.right[k] = x.share;
      out.down[k] = y.share;
    }
  }
};

}  // namespace parhelion::PH_ISA
