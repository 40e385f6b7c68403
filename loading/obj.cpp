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
  explicit Lines(std::string_view text) : rest_(text) {}

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

void add_unknown(std::string word, std::vector<std::string>& all) {
  if (all.size() < kMostUnknown && std::find(all.begin(), all.end(), word) == all.end()) {
    all.push_back(std::move(word));
  }
}

// Reads a text, or a block of one that others precede. A block does not know what those hold: where
// that matters, as for what is wrong, it throws, and the text is to be read as one.
class Reader {
 public:
  explicit Reader(std::string_view text, bool block = false) : lines_(text), block_(block) {}

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
    if (!block_) check();
    if (plain_) {
      found_.width = 1;
      std::vector<int>& all = found_.corners;
      for (size_t c = 0; c < all.size() / 3; ++c) all[c] = all[3 * c];
      all.resize(all.size() / 3);
    }
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
    if (!block_) face_lines_.push_back(lines_.number());
  }

  void unknown(std::string_view word) { add_unknown(printable(word), found_.unknown); }

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
      if (negative && block_) fail("counts back");
      if (negative) index = count(kind) + 1 - index;
      if (index < 0 || (index == 0 && (negative || kind == 0))) {
        fail(refers(found_.sizes.size(), kind, negative ? index - count(kind) - 1 : 0));
      }
      indices[kind] = static_cast<int>(index - 1);
      if (at == end || is_blank(*at)) break;
      if (kind == 2 || *at++ != '/') fail_corner(words);
      plain_ = false;
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
  bool block_;
  ObjText found_;
  std::vector<u32> face_lines_;
  std::array<double, 6> extra_{};  // of a line, by their place
  bool colored_ = true;
  bool plain_ = true;  // corners are positions alone
};

// Cuts a text into blocks, between lines without a backslash, which may join them with the next.
std::vector<std::string_view> cut(std::string_view text, size_t block) {
  std::vector<std::string_view> blocks;
  for (size_t begin = 0; begin < text.size();) {
    size_t end = begin + block;
    while (end < text.size()) {
      // To the end of the line that the place is in, or before which it is
      const size_t line = text.rfind('\n', end - 1) + 1;
      end = std::min(text.find('\n', end), text.size() - 1) + 1;
      if (text.substr(line, end - line).find('\\') == std::string_view::npos) break;
    }
    end = std::min(end, text.size());
    blocks.push_back(text.substr(begin, end - begin));
    begin = end;
  }
  return blocks;
}

void widen(ObjText& text) {
  if (text.width == 3) return;
  std::vector<int> wide(3 * text.corners.size(), -1);
  for (size_t c = 0; c < text.corners.size(); ++c) wide[3 * c] = text.corners[c];
  text.corners = std::move(wide);
  text.width = 3;
}

ObjText join(std::vector<ObjText>& blocks) {
  ObjText all;
  all.width = 1;
  for (ObjText& block : blocks) {
    for (ObjStatement& s : block.statements) {
      s.polygon += static_cast<u32>(all.sizes.size());
      all.statements.push_back(std::move(s));
    }
    for (std::string& word : block.unknown) add_unknown(std::move(word), all.unknown);
    all.sizes.insert(all.sizes.end(), block.sizes.begin(), block.sizes.end());
    all.width = std::max(all.width, block.width);
  }
  if (all.width == 3) std::for_each(blocks.begin(), blocks.end(), widen);
  all.positions = joined<double>(blocks, [](ObjText& b) -> auto& { return b.positions; });
  all.uvs = joined<double>(blocks, [](ObjText& b) -> auto& { return b.uvs; });
  all.normals = joined<double>(blocks, [](ObjText& b) -> auto& { return b.normals; });
  all.colors = joined<double>(blocks, [](ObjText& b) -> auto& { return b.colors; });
  all.corners = joined<int>(blocks, [](ObjText& b) -> auto& { return b.corners; });
  return all;
}

// Whether all indices of a text are those of something in it.
bool in_range(const ObjText& text) {
  const size_t counts[3] = {text.positions.size() / 3, text.uvs.size() / 2,
                            text.normals.size() / 3};
  for (size_t c = 0; c < text.corners.size(); ++c) {
    if (text.corners[c] >= static_cast<i64>(counts[c % text.width])) return false;
  }
  return true;
}

ObjText read_text(std::string_view text, size_t block) {
  const std::vector<std::string_view> cuts = cut(text, block);
  if (cuts.size() > 1) {
    try {
      std::vector<ObjText> blocks(cuts.size());
      read_blocks(static_cast<int>(cuts.size()),
                  [&](int i) { blocks[i] = Reader(cuts[i], true).read(); });
      ObjText all = join(blocks);
      if (in_range(all)) return all;
    } catch (const ObjError&) {
      // which the whole text, read as one, will tell of rightly
    }
  }
  return Reader(text).read();
}

}  // namespace

ObjText parse_obj(std::string_view text, size_t block) {
  if (text.substr(0, 3) == "\xef\xbb\xbf") text.remove_prefix(3);  // UTF-8's mark
  ObjText found = read_text(text, block);
  if (found.colors.size() != found.positions.size()) found.colors.clear();
  return found;
}

}  // namespace parhelion
