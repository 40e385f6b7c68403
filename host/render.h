// Rendering: tiles over OpenMP threads, added to a film in an order that does not matter.
#pragma once
#include <functional>
#include <span>
#include <vector>

#include "array.h"
#include "kernels.h"
#include "scene.h"

namespace parhelion {

// Pairs of id and coverage that a pixel keeps of a Cryptomatte, the specification's suggestion.
inline constexpr size_t kMatteRanks = 6;

// The film is divided into blocks of so many pixels a side, from its top left one on. The even rows
// of a block are one cell and its odd rows another: what targets are set for and errors told of.
// What the samples of one tell decides how many the other gets: a mean must not decide over its own
// number of samples, or it ends where it happens to be low.
inline constexpr u32 kBlock = 8;

// Means of a pixel's first samples: of the largest power of two of them that are there, and of half
// as many. What differs between them and the rest tells how far the mean is from the truth.
struct Prefix {
  float half[3], whole[3];
};

// The sums of a rectangle of the picture. x, y: its top left pixel within the whole picture.
struct Film {
  u32 x, y, width, height;
  Array<FilmPixel> pixels;
  Array<FeaturePixel> features;  // as many, or none
  Array<Prefix> prefixes;        // as many, or none, and no errors can be told then

  Film(u32 x, u32 y, u32 width, u32 height, bool with_features = false, bool with_errors = false);
  FilmPixel& pixel(u32 px, u32 py) { return pixels[size_t{py} * width + px]; }
  Prefix& prefix(u32 px, u32 py) { return prefixes[size_t{py} * width + px]; }
  // Cells lie in rows of one a block: the even ones of the first row of blocks, the odd ones of it,
  // the even ones of the next, and so on.
  u32 cells_across() const { return (width + kBlock - 1) / kBlock; }
  u32 cells_down() const { return 2 * ((height + kBlock - 1) / kBlock); }
  u32 cell_row(u32 row) const { return 2 * (row / kBlock) + row % 2; }
  // For each cell the mean over its pixels of the squared standard error of a pixel relative to its
  // brightness; infinite where a pixel has fewer than two samples. Of odd rows where there is but
  // an even one, it is that one's. See error.cpp.
  void errors(double* mean_squares) const;
  // For each pixel the estimated variance of its mean, itself the mean over the three channels;
  // infinite with fewer than two samples. It rests on three numbers: only sums over many say much.
  void variances(float* of_pixels) const;
  // Has the pixels of an empty film go on after so many samples, row by row, as if these had been
  // black: what add() takes is the sums of what comes after.
  void begin(std::span<const u32> counts);
  // Adds what a part, whose pixels began, by begin(), where those of this film are, has seen since.
  // Features are taken over as they are: it must have begun with this film's. Where errors are
  // told, a pixel begins with no sample, and the part tells its errors, too, or goes no further
  // than the next power of two. Throws SceneError, before anything is added, if not so.
  void add(const Film& part, std::span<const u32> begun);
  // Means, (height, width, 3). A pixel without samples is black.
  void means(float* rgb) const;
  // Cryptomatte's ranks, (height, width, kMatteRanks, 2): ids[index], as the bits of a float, and
  // the share of the samples that saw it, the largest first, equal ones by id; zeros where there
  // are no more. Indices with the same id are one. Throws std::out_of_range for an index without an
  // id.
  void ranks(Tally FeaturePixel::* tally, std::span<const u32> ids, float* out) const;
};

enum class Schedule { dynamic_, static_, guided };

struct RenderOptions {
  int threads = 1;
  u32 tile = 16;  // edge of a tile, in pixels
  Schedule schedule = Schedule::dynamic_;
};

struct PassResult {
  u64 samples = 0, rays = 0;
  double traversal_seconds = 0.0;  // of all threads, to walk trees; estimated, see kTimedWalks
  bool complete = true;            // false if `tick` stopped it
};

// How many samples each cell of a film is to have, or each pixel, row by row.
struct Targets {
  std::vector<u32> samples;
  bool by_pixel = false;

  u32 of(const Film& film, u32 x, u32 y) const {
    return by_pixel ? samples[size_t{y} * film.width + x]
                    : samples[size_t{film.cell_row(y)} * film.cells_across() + x / kBlock];
  }
};

// Called now and then by the calling thread with what the pass has done so far; true stops it.
using Tick = std::function<bool(u64 samples, u64 rays)>;

// A film, what it shows, and how many samples it is to have.
struct Part {
  const RenderView& view;
  Film& film;
  const Targets& targets;
};

// Brings every pixel of some films up to the number of samples that its target says. Those that it
// has stay: a pass that was stopped goes on if it is asked for again. The threads share the tiles
// of all.
PassResult render_pass(const Kernels& kernels, const Scene& scene, std::span<const Part> parts,
                       const RenderOptions& options, const Tick& tick);

inline PassResult render_pass(const Kernels& kernels, const Scene& scene, const RenderView& view,
                              Film& film, const Targets& targets, const RenderOptions& options,
                              const Tick& tick) {
  const Part whole = {view, film, targets};
  return render_pass(kernels, scene, {&whole, 1}, options, tick);
}

// Lets go of OpenMP's threads, which do not survive a fork.
void release_threads();

}  // namespace parhelion
