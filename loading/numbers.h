// Numbers in text.
#pragma once
#include <string_view>
#include <vector>

namespace parhelion {

constexpr bool is_blank(char c) { return c == ' ' || (c >= '\t' && c <= '\r'); }

// Reads the number that begins at `at` and ends at a blank or the end: where that is, or null for
// anything else. What is too large for a double becomes infinite, what is too small 0.
const char* parse_number(const char* at, const char* end, double& value);

// The numbers of a text, separated by blanks. Throws std::invalid_argument for anything else.
std::vector<double> parse_numbers(std::string_view text);

}  // namespace parhelion
