// Texts in blocks, which threads read.
#pragma once
#include <cstddef>
#include <exception>
#include <utility>
#include <vector>

namespace parhelion {

// Bytes of a block. Texts that are shorter are read by one thread.
inline constexpr std::size_t kBlock = std::size_t{1} << 18;

// read(i) for each of n blocks. Of what they throw, which may not leave a thread, the first one's
// is thrown.
template <class Read>
void read_blocks(int n, const Read& read) {
  std::vector<std::exception_ptr> problems(static_cast<std::size_t>(n));
#pragma omp parallel for schedule(dynamic) if (n > 1)
  for (int i = 0; i < n; ++i) {
    try {
      read(i);
    } catch (...) {
      problems[static_cast<std::size_t>(i)] = std::current_exception();
    }
  }
  for (const std::exception_ptr& problem : problems) {
    if (problem) std::rethrow_exception(problem);
  }
}

// What part(block) gives of every block, one after the other; it is emptied.
template <class T, class Block, class Part>
std::vector<T> joined(std::vector<Block>& blocks, const Part& part) {
  if (blocks.size() == 1) return std::move(part(blocks[0]));
  std::size_t total = 0;
  for (Block& block : blocks) total += part(block).size();
  std::vector<T> all;
  all.reserve(total);
  for (Block& block : blocks) {
    std::vector<T>& values = part(block);
    all.insert(all.end(), values.begin(), values.end());
    values = {};
  }
  return all;
}

}  // namespace parhelion
