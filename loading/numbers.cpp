#include "numbers.h"

#include <algorithm>
#include <charconv>
#include <limits>
#include <stdexcept>

#include "blocks.h"

namespace parhelion {
namespace {

// The value of a number that std::from_chars finds out of range.
double beyond(const char* at, const char* end) {
  const bool negative = *at == '-';
  // How many digits stand before the point without leading zeros, or minus the zeros behind it
  long long power = 0;
  bool leading = true, behind = false;
  for (at += negative; at < end && *at != 'e' && *at != 'E'; ++at) {
    if (*at == '.') {
      behind = true;
    } else if (leading && *at == '0') {
      power -= behind;
    } else {
      leading = false;
      power += !behind;
    }
  }
  if (at < end) {
    const bool down = at + 1 < end && at[1] == '-';
    long long exponent = 0;
    for (at += 1 + (at + 1 < end && (at[1] == '-' || at[1] == '+')); at < end; ++at) {
      exponent = std::min(exponent * 10 + (*at - '0'), 1'000'000'000'000ll);
    }
    power += down ? -exponent : exponent;
  }
  const double value = power > 0 ? std::numeric_limits<double>::infinity() : 0.0;
  return negative ? -value : value;
}

// Whole numbers of so few digits are exact in a double.
constexpr int kExactDigits = 15;

std::vector<double> parse_block(const char* at, const char* end) {
  std::vector<double> values;
  while (true) {
    while (at < end && is_blank(*at)) ++at;
    if (at == end) return values;
    double value;
    at = parse_number(at, end, value);
    if (at == nullptr) throw std::invalid_argument("something that is no number");
    values.push_back(value);
  }
}

}  // namespace

const char* parse_number(const char* at, const char* end, double& value) {
  const char* digit = at + (at < end && (*at == '-' || *at == '+'));
  const char* begin = digit;
  long long whole = 0;
  while (digit < end && digit - begin < kExactDigits && *digit >= '0' && *digit <= '9') {
    whole = whole * 10 + (*digit++ - '0');
  }
  if (digit > begin && (digit == end || is_blank(*digit))) {
    value = static_cast<double>(whole);
    if (*at == '-') value = -value;
    return digit;
  }
  if (begin < end && *at == '+') {  // which from_chars does not know
    if (*begin == '-') return nullptr;
    at = begin;
  }
  const auto [stop, problem] = std::from_chars(at, end, value);
  if (problem == std::errc::result_out_of_range) {
    value = beyond(at, stop);
  } else if (problem != std::errc{}) {
    return nullptr;
  }
  return stop == end || is_blank(*stop) ? stop : nullptr;
}

std::vector<double> parse_numbers(std::string_view text) {
  const char* begin = text.data();
  const char* end = begin + text.size();
  // Blocks begin and end at blanks. What they hold is joined in their order.
  const int count = static_cast<int>(text.size() / kBlock) + 1;
  std::vector<const char*> cuts(count + 1, end);
  cuts[0] = begin;
  for (int i = 1; i < count; ++i) {
    const char* at = std::max(begin + i * kBlock, cuts[i - 1]);
    cuts[i] = std::find_if(at, end, is_blank);
  }
  std::vector<std::vector<double>> blocks(count);
  read_blocks(count, [&](int i) { blocks[i] = parse_block(cuts[i], cuts[i + 1]); });
  return joined<double>(blocks, [](auto& block) -> auto& { return block; });
}

}  // namespace parhelion
