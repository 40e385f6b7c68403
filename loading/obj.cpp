#include "obj.h"

#include <algorithm>
#include <array>
#include <limits>
#include <utility>

#include "numbers.h"

namespace parhelion {
namespace {

constexpr const char* kNouns[3] = {"vertex", "texture coordinate", "normal"};
constexpr size_t kMostUnknown = 20;
constexpr i64 kMost = std::numeric_limits<int>::max();

// Goes over the lines of a text without their comments, those that end with a backslash joined with
// the next.
class Lines {
 public:
  explicit Lines(std::string_view text) : rest_(text) {
    if (rest_.substr(0, 3) == "\xef\xbb\xbf") rest_.remove_prefix(3);  // UTF-8's mark
  }

  bool next(std::string_view& line) {
    if (rest_.empty()) return false;
    number_ += joined_lines_;
    joined_lines_ = 1;
    line = take();
    if (!continues(line)) return true;
    joined_.clear();
    while (continues(line)) {
      joined_.append(line.substr(0, line.rfind('\\'))).push_back(' ');
      line = take();
      ++joined_lines_;
    }
    line = joined_.append(line);
    return true;
  }
  // Of the line, from 1; of joined ones, the first.
  u32 number() const { return number_; }

 private:
  std::string_view take() {
    const size_t size = std::min(rest_.find('\n'), rest_.size());
    const std::string_view line = rest_.substr(0, size);
    rest_.remove_prefix(std::min(size + 1, rest_.size()));
    return line.substr(0, line.find('#'));
  }
  static bool continues(std::string_view line) {
    if (!line.empty() && line.back() == '\r') line.remove_suffix(1);
    return !line.empty() && line.back() == '\\';
  }

  std::string_view rest_;
  std::string joined_;
  u32 number_ = 0, joined_lines_ = 1;
};

// Goes over the words of a line, which is kept by another.
class Words {
 public:
  explicit Words(std::string_view line) : at_(line.data()), end_(at_ + line.size()) { skip(); }
  bool done() const { return at_ == end_; }
  std::string_view next() {
    const char* begin = at_;
    while (at_ < end_ && !is_blank(*at_)) ++at_;
    const std::string_view word(begin, static_cast<size_t>(at_ - begin));
    skip();
    return word;
  }
  bool number(double& value) {
    const char* stop = parse_number(at_, end_, value);
    if (stop != nullptr) move(stop);
    return stop != nullptr;
  }
  const char* at() const { return at_; }
  const char* end() const { return end_; }
  // To the word that begins at `to` or behind the blanks there.
  void move(const char* to) {
    at_ = to;
    skip();
  }
  std::string_view rest() const {
    const char* last = end_;
    while (last > at_ && is_blank(last[-1])) --last;
    return {at_, static_cast<size_t>(last - at_)};
  }

 private:
  void skip() {
    while (at_ < end_ && is_blank(*at_)) ++at_;
  }
  const char* at_;
  const char* end_;
};

class Reader {
 public:
  explicit Reader(std::string_view text) : lines_(text) {}

  ObjText read() {
    std::string_view line;
    while (lines_.next(line)) {
      Words words(line);
      const std::string_view word = words.next();
      if (word == "v") {
        position(words);
      } else if (word == "f") {
        face(words);
      } else if (word == "vt") {
        numbers(words, 1, 2, found_.uvs, kNouns[1]);
      } else if (word == "vn") {
        numbers(words, 3, 3, found_.normals, kNouns[2]);
      } else if (word == "usemtl" || word == "mtllib") {
        found_.statements.push_back(
            {static_cast<u32>(found_.sizes.size()), std::string(word), std::string(words.rest())});
      } else if (!word.empty() && word != "g" && word != "o" && word != "s") {
        unknown(word);
      }
    }
    check();
    return std::move(found_);
  }

 private:
  // The first numbers of a line, of which `least` are needed and others are 0; how many there are.
  size_t numbers(Words& words, size_t least, size_t width, std::vector<double>& values,
                 const char* noun) {
    size_t count = 0;
    for (; !words.done(); ++count) {
      double value;
      if (!words.number(value)) {
        fail(std::string("the ") + noun + " holds something that is no number");
      }
      if (count < width) {
        values.push_back(value);
      } else if (count < extra_.size()) {
        extra_[count] = value;
      }
    }
    if (count < least) fail("has fewer than " + std::to_string(least) + " numbers");
    for (size_t k = count; k < width; ++k) values.push_back(0.0);
    return count;
  }

  // Some programs write a colour behind the coordinates.
  void position(Words& words) {
    const size_t count = numbers(words, 3, 3, found_.positions, kNouns[0]);
    colored_ = colored_ && count == 6;
    if (colored_) {
      found_.colors.insert(found_.colors.end(), extra_.begin() + 3, extra_.begin() + 6);
    }
  }

  void face(Words& words) {
    u32 size = 0;
    for (; !words.done(); ++size) corner(words);
    if (size < 3) fail("a face needs at least 3 corners");
    found_.sizes.push_back(size);
    face_lines_.push_back(lines_.number());
  }

  void unknown(std::string_view word) {
    std::string shown = printable(word);
    std::vector<std::string>& all = found_.unknown;
    if (all.size() < kMostUnknown && std::find(all.begin(), all.end(), shown) == all.end()) {
      all.push_back(std::move(shown));
    }
  }

  // v, v/vt, v//vn or v/vt/vn: from 1, or back from the last that came before.
  void corner(Words& words) {
    int indices[3] = {-1, -1, -1};
    const char* at = words.at();
    const char* end = words.end();
    for (int kind = 0; kind < 3; ++kind) {
      const bool negative = at < end && *at == '-';
      const char* begin = at += negative;
      i64 index = 0;
      for (; at < end && *at >= '0' && *at <= '9'; ++at) {
        index = std::min(index * 10 + (*at - '0'), kMost);
      }
      if (index == kMost) {
        fail("face " + std::to_string(found_.sizes.size()) + " refers to " +
             printable(words.next()) + ", more than there can be");
      }
      if (at == begin && (kind == 0 || negative)) fail_corner(words);
      if (negative) index = count(kind) + 1 - index;
      if (index < 0 || (index == 0 && (negative || kind == 0))) {
        fail(refers(found_.sizes.size(), kind, negative ? index - count(kind) - 1 : 0));
      }
      indices[kind] = static_cast<int>(index - 1);
      if (at == end || is_blank(*at)) break;
      if (kind == 2 || *at++ != '/') fail_corner(words);
    }
    words.move(at);
    found_.corners.insert(found_.corners.end(), indices, indices + 3);
  }

  // What is not too large for all may be so for those that the file has.
  void check() const {
    size_t corner = 0;
    for (size_t face = 0; face < found_.sizes.size(); ++face) {
      for (u32 i = 0; i < found_.sizes[face]; ++i, ++corner) {
        for (int kind = 0; kind < 3; ++kind) {
          const i64 index = found_.corners[3 * corner + kind];
          if (index >= count(kind)) fail(refers(face, kind, index + 1), face_lines_[face]);
        }
      }
    }
  }

  i64 count(int kind) const {
    const size_t counts[3] = {found_.positions.size() / 3, found_.uvs.size() / 2,
                              found_.normals.size() / 3};
    return static_cast<i64>(counts[kind]);
  }
  std::string refers(size_t face, int kind, i64 index) const {
    return "face " + std::to_string(face) + " refers to " + kNouns[kind] + " " +
           std::to_string(index) + "; there are " + std::to_string(count(kind));
  }
  [[noreturn]] void fail_corner(Words words) const {
    fail("'" + printable(words.next()) + "' is no corner v/vt/vn");
  }
  static std::string printable(std::string_view word) {
    std::string shown(word.substr(0, 40));
    for (char& c : shown) c = c > ' ' && c <= '~' ? c : '?';
    return shown;
  }
  [[noreturn]] void fail(const std::string& text) const { fail(text, lines_.number()); }
  [[noreturn]] static void fail(const std::string& text, u32 line) {
    throw ObjError("line " + std::to_string(line) + ": " + text);
  }

  Lines lines_;
  ObjText found_;
  std::vector<u32> face_lines_;
  std::array<double, 6> extra_{};  // of a line, by their place
  bool colored_ = true;
};

}  // namespace

ObjText parse_obj(std::string_view text) {
  ObjText found = Reader(text).read();
  if (found.colors.size() != found.positions.size()) found.colors.clear();
  return found;
}

}  // namespace parhelion
