// What reads files, against plain statements of the same, for the sanitizers to watch.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <set>
#include <string>
#include <vector>

#include "../../loading/normals.h"
#include "../../loading/numbers.h"
#include "../../loading/obj.h"
#include "../../loading/polygons.h"
#include "../../loading/rows.h"
#include "check.h"

namespace {

using namespace parhelion;

// From 0 to below n, by a linear congruence.
u32 draw(u32 n) {
  static u64 state = 1;
  state = state * 6364136223846793005ull + 1442695040888963407ull;
  return static_cast<u32>((state >> 33) % n);
}

bool same(double a, double b) { return std::memcmp(&a, &b, sizeof a) == 0; }

void numbers_are_those_of_the_c_library() {
  std::string text;
  std::vector<double> expected;
  for (int i = 0; i < 100'000; ++i) {
    char word[64];
    const double value = (draw(1u << 31) - 1e9) * std::pow(10.0, int(draw(80)) - 40);
    const char* forms[] = {"%.17g", "%.6f", "%.0f", "%+.3e", "%g"};
    std::snprintf(word, sizeof word, forms[draw(5)], value);
    expected.push_back(std::strtod(word, nullptr));
    text += word;
    text += " \t\n\r\f\v"[draw(6)];
  }
  const std::vector<double> found = parse_numbers(text);
  CHECK(found.size() == expected.size());
  CHECK(std::equal(found.begin(), found.end(), expected.begin(), same));
}

void numbers_at_the_ends_of_their_range() {
  for (const char* word : {"0",
                           "-0",
                           "+7",
                           "007",
                           ".5",
                           "5.",
                           "-.25e1",
                           "1e308",
                           "1e309",
                           "-1e309",
                           "4.9e-324",
                           "1e-330",
                           "-1e-330",
                           "0.0001e400",
                           "10000e-400",
                           "1e99999999999999999999",
                           "1e-99999999999999999999",
                           "0e999",
                           "123456789012345",
                           "1234567890123456789",
                           "9007199254740993",
                           "inf",
                           "-INF",
                           "infinity"}) {
    const std::vector<double> found = parse_numbers(word);
    CHECK(found.size() == 1 && same(found[0], std::strtod(word, nullptr)));
  }
  CHECK(std::isnan(parse_numbers("nan")[0]));
  CHECK(parse_numbers("").empty() && parse_numbers(" \n ").empty());
  for (const char* word : {"x", "1x", "1,2", "--1", "+-1", "1e", "0x10", "-", "+", ".", "1 2 q"}) {
    bool refused = false;
    try {
      parse_numbers(word);
    } catch (const std::invalid_argument&) {
      refused = true;
    }
    CHECK(refused);
  }
}

void equal_rows_are_found() {
  for (u32 width : {1u, 3u, 5u}) {
    const u32 n = 20'000;
    std::vector<u32> rows(n * width);
    for (u32& word : rows) word = draw(width == 1 ? 5000 : 12);
    const DistinctRows found = distinct_rows(rows.data(), n, width);
    std::set<std::vector<u32>> seen;
    for (u32 i = 0; i < n; ++i) {
      const std::vector<u32> row(&rows[i * width], &rows[i * width] + width);
      const u32 first = found.first[found.which[i]];
      CHECK(std::equal(row.begin(), row.end(), &rows[first * width]));
      CHECK(seen.insert(row).second == (first == i));
    }
    CHECK(found.first.size() == seen.size());
    CHECK(std::is_sorted(found.first.begin(), found.first.end()));
  }
}

// A bent strip of two quads' triangles: the second pair turns up by `degrees`.
void creases_split_vertices() {
  const double up = std::sin(60 * 3.14159265358979 / 180), on = 0.5;
  const std::vector<double> strip = {0, 0, 0, 0,      1, 0,  1,      0, 0,
                                     1, 1, 0, 1 + on, 0, up, 1 + on, 1, up};
  const std::vector<u32> faces = {0, 2, 1, 1, 2, 3, 2, 4, 3, 3, 4, 5};
  const ShadedMesh sharp = shade(strip.data(), 6, faces.data(), 4, 59.0);
  CHECK(sharp.old.size() == 8);
  for (int c = 0; c < 6; ++c) CHECK(sharp.normals[sharp.faces[c]].z > 0.9999f);
  for (int c = 6; c < 12; ++c) CHECK(std::abs(sharp.normals[sharp.faces[c]].z - 0.5f) < 1e-6f);
  const ShadedMesh smooth = shade(strip.data(), 6, faces.data(), 4, 61.0);
  CHECK(smooth.old.size() == 6);
  CHECK(std::equal(faces.begin(), faces.end(), smooth.faces.begin()));
  bool refused = false;
  try {
    shade(strip.data(), 5, faces.data(), 4, std::nullopt);
  } catch (const std::out_of_range&) {
    refused = true;
  }
  CHECK(refused);
}

// Any faces, with repeated corners, edges of many faces and vertices of none: each vertex keeps its
// place, and no vertex is nobody's.
void wild_meshes_keep_their_places() {
  for (u32 round = 0; round < 60; ++round) {
    const u32 n = 3 + draw(40), m = round < 3 ? 5000 : draw(200);
    std::vector<float> vertices(3 * n);
    for (float& x : vertices) x = static_cast<float>(draw(5));
    std::vector<u32> faces(3 * m);
    for (u32& index : faces) index = draw(n);
    const ShadedMesh mesh = shade(vertices.data(), n, faces.data(), m, 40.0);
    std::vector<char> used(mesh.old.size());
    for (size_t c = 0; c < faces.size(); ++c) {
      CHECK(mesh.old[mesh.faces[c]] == faces[c]);
      used[mesh.faces[c]] = 1;
    }
    CHECK(std::find(used.begin(), used.end(), 0) == used.end());
    for (const Vec3& v : mesh.normals)
      CHECK(std::abs(v.x * v.x + v.y * v.y + v.z * v.z - 1) < 1e-5f);
    const ShadedMesh all = shade(vertices.data(), n, faces.data(), m, std::nullopt);
    CHECK(all.faces == faces && all.normals.size() == n);
  }
}

// Any polygons, flat or not, that may cross themselves: n corners are n - 2 triangles of their own.
void wild_polygons_are_cut() {
  for (u32 round = 0; round < 300; ++round) {
    const u32 n = 1 + draw(30);
    std::vector<double> vertices(3 * n);
    for (double& x : vertices) x = draw(round % 3 == 0 ? 3 : 1000);
    std::vector<u32> counts, corners;
    size_t triangles = 0;
    for (u32 p = draw(6); p-- > 0;) {
      counts.push_back(3 + draw(40));
      triangles += counts.back() - 2;
      for (u32 i = 0; i < counts.back(); ++i) corners.push_back(draw(n));
    }
    const std::vector<u32> places = triangulate(vertices.data(), counts.data(),
                                                static_cast<u32>(counts.size()), corners.data());
    CHECK(places.size() == 3 * triangles);
    size_t at = 0;
    u32 first = 0;
    for (u32 count : counts) {
      std::set<u32> seen;
      for (u32 k = 0; k < 3 * (count - 2); ++k, ++at) {
        CHECK(places[at] >= first && places[at] < first + count);
        seen.insert(places[at]);
      }
      CHECK(seen.size() == count);
      first += count;
    }
  }
}

const char kObj[] =
    "mtllib a b.mtl # for all\nv 0 0 0 1 0.5 0.25\nv 1 0 0 1 1 1\r\n v\t1 1 0 0 0 0\nv 0 1 0 0 0 "
    "0\n"
    "vt 0 0\nvt 1 1 0\nvn 0 0 1\ng name\nusemtl red \nf 1/1/1 2/2/1 \\\n 3//1 -1\n\nf -4 -3 -2\nvp "
    "1\n";

void obj_lines_are_read() {
  const ObjText text = parse_obj(kObj);
  CHECK(text.positions.size() == 12 && text.colors.size() == 12 && text.colors[1] == 0.5);
  CHECK((text.uvs == std::vector<double>{0, 0, 1, 1}));
  CHECK((text.normals == std::vector<double>{0, 0, 1}));
  CHECK((text.sizes == std::vector<u32>{4, 3}));
  CHECK((text.corners ==
         std::vector<int>{0, 0, 0, 1, 1, 0, 2, -1, 0, 3, -1, -1, 0, -1, -1, 1, -1, -1, 2, -1, -1}));
  CHECK(text.unknown == std::vector<std::string>{"vp"});
  CHECK(text.statements.size() == 2 && text.statements[0].rest == "a b.mtl" &&
        text.statements[1].rest == "red" && text.statements[1].polygon == 0);
}

void broken_obj_lines_are_named() {
  const std::string head = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
  const std::pair<const char*, const char*> cases[] = {
      {"f 1 2 4\n", "line 4: face 0 refers to vertex 4; there are 3"},
      {"f 1 2 0\n", "line 4: face 0 refers to vertex 0; there are 3"},
      {"f 1 2 -4\n", "line 4: face 0 refers to vertex -4; there are 3"},
      {"f 1/1 2/1 3/1\n", "line 4: face 0 refers to texture coordinate 1; there are 0"},
      {"f 1 2\n", "line 4: a face needs at least 3 corners"},
      {"f 1 2 3/1/1/1\n", "line 4: '3/1/1/1' is no corner v/vt/vn"},
      {"f 1 2 3.5\n", "line 4: '3.5' is no corner v/vt/vn"},
      {"v 1 2\n", "line 4: has fewer than 3 numbers"},
      {"#\\\n\nvn 1 2 z\n", "line 6: the normal holds something that is no number"},
  };
  for (const auto& [tail, message] : cases) {
    std::string told;
    try {
      parse_obj(head + tail);
    } catch (const ObjError& e) {
      told = e.what();
    }
    if (told != message) std::printf("%s: %s\n", tail, told.c_str());
    CHECK(told == message);
  }
}

// What parse_obj says of a text, as one block or as many, in words.
std::string told(const std::string& text, size_t block) {
  std::string words;
  const auto add = [&](const char* name, const auto& values) {
    words += name;
    for (const auto& value : values) words += ' ' + std::to_string(value);
  };
  try {
    const ObjText found = parse_obj(text, block);
    add("v", found.positions), add("vt", found.uvs), add("vn", found.normals);
    add("colors", found.colors), add("sizes", found.sizes), add("corners", found.corners);
    for (const ObjStatement& s : found.statements) {
      words += std::to_string(s.polygon) + s.word + s.rest + ';';
    }
    for (const std::string& word : found.unknown) words += word + ';';
    const size_t counts[3] = {found.positions.size() / 3, found.uvs.size() / 2,
                              found.normals.size() / 3};
    for (size_t c = 0; c < found.corners.size(); ++c) {
      const size_t kind = c % found.width;
      CHECK(found.corners[c] < int(counts[kind]) && found.corners[c] >= (kind ? -1 : 0));
    }
  } catch (const ObjError& e) {
    words = e.what();
  }
  return words;
}

void mutated_obj_text_is_the_same_in_blocks() {
  const char some[] = "0123456789-+.e/\\ \n\rvtnf#u";
  const std::string plain = "v 0 0 0\nv 1 0 0\n# \\\nf 1 2 3\nv 0 1 0\nusemtl m\nf 3 2 1\nl 1 2\n";
  for (int round = 0; round < 8'000; ++round) {
    std::string text(draw(2) ? plain : kObj);
    // Counting back is of what the whole text alone tells, and not all there is to try
    if (const size_t back = text.find(" -"); draw(2) && back < text.size()) text.resize(back);
    for (u32 k = draw(4); k > 0; --k) {
      const u32 at = draw(static_cast<u32>(text.size()));
      switch (draw(3)) {
        case 0: text[at] = some[draw(sizeof some - 1)]; break;
        case 1: text.erase(at, 1 + draw(6)); break;
        default: text.insert(at, 1 + draw(12), some[draw(sizeof some - 1)]);
      }
    }
    CHECK(told(text, 1 + draw(40)) == told(text, kBlock));
  }
}

}  // namespace

int main() {
  numbers_are_those_of_the_c_library();
  numbers_at_the_ends_of_their_range();
  equal_rows_are_found();
  creases_split_vertices();
  wild_meshes_keep_their_places();
  wild_polygons_are_cut();
  obj_lines_are_read();
  broken_obj_lines_are_named();
  mutated_obj_text_is_the_same_in_blocks();
  std::printf(failures == 0 ? "loading: ok\n" : "loading: %d failures\n", failures);
  return failures != 0;
}
