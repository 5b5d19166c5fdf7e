// Model files: what is written is read back, and every malformed file is an error that names what is wrong.
#include <gtest/gtest.h>

#include <unistd.h>

#include <cstring>
#include <filesystem>
#include <functional>
#include <limits>

#include <iclk/align/model/json.h>
#include <iclk/align/model/safetensors.h>
#include <iclk/align/model_file.h>
#include <iclk/engine/error.h>

#include "random_model.h"

namespace iclk {
namespace {

using internal::Safetensors;
using test::random_model;

Model small_model() { return random_model({{2, 3}, {4}}); }
Safetensors content_of(const Model& model) { return internal::parse_safetensors(model_bytes(model)); }

template <class F>
std::string refusal(F&& act) {
  try {
    act();
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::invalid_argument) << e.what();
    return e.what();
  }
  return "no error";
}

void expect_says(const std::string& text, std::initializer_list<const char*> pieces) {
  for (const char* piece : pieces) EXPECT_NE(text.find(piece), std::string::npos) << "'" << piece << "' in: " << text;
}

void expect_refused(const std::vector<uint8_t>& bytes, std::initializer_list<const char*> pieces) {
  const std::string text = refusal([&] { parse_model(bytes, "bad.safetensors"); });
  expect_says(text, {"model bad.safetensors: "});
  expect_says(text, pieces);
}

void expect_same(const std::vector<ConvLayer>& a, const std::vector<ConvLayer>& b) {
  ASSERT_EQ(a.size(), b.size());
  for (size_t i = 0; i < a.size(); ++i) {
    EXPECT_EQ(a[i].in, b[i].in);
    EXPECT_EQ(a[i].out, b[i].out);
    EXPECT_EQ(a[i].dilation, b[i].dilation);
    EXPECT_EQ(a[i].weight, b[i].weight);
    EXPECT_EQ(a[i].bias, b[i].bias);
  }
}

void expect_same(const Model& a, const Model& b) {
  EXPECT_EQ(a.name, b.name);
  EXPECT_EQ(a.licence, b.licence);
  EXPECT_EQ(a.provenance, b.provenance);
  EXPECT_EQ(a.input_channels, b.input_channels);
  EXPECT_EQ(a.normalisation, b.normalisation);
  for (int c = 0; c < a.input_channels; ++c) {
    EXPECT_EQ(a.mean[static_cast<size_t>(c)], b.mean[static_cast<size_t>(c)]);
    EXPECT_EQ(a.std[static_cast<size_t>(c)], b.std[static_cast<size_t>(c)]);
  }
  EXPECT_EQ(a.iterations, b.iterations);
  EXPECT_EQ(a.damping, b.damping);
  EXPECT_EQ(a.carry, b.carry);
  ASSERT_EQ(a.levels(), b.levels());
  for (size_t l = 0; l < a.encoder.size(); ++l) expect_same(a.encoder[l], b.encoder[l]);
  expect_same(a.m_estimator, b.m_estimator);
}

std::filesystem::path new_folder() {
  std::string pattern = (std::filesystem::temp_directory_path() / "iclk_model_XXXXXX").string();
  return mkdtemp(pattern.data());
}

TEST(ModelFile, WhatIsWrittenIsRead) {
  Model five = random_model({{2, 3, 4}, {4, 4, 4}, {5}, {6, 2}, {7}}, 1);
  five.name = "five \"levels\" \\ \xc3\xa9";
  five.damping = 0.1;
  five.iterations = 17;
  five.carry = 0.3;
  five.normalisation = Normalisation::image;
  Model plain = small_model();
  plain.m_estimator.clear();
  for (const Model& model : {small_model(), five, plain}) expect_same(parse_model(model_bytes(model), "m"), model);
}

TEST(ModelFile, FilesAreWholeOrNotThere) {
  const auto folder = new_folder();
  const std::string path = folder / "m.safetensors";
  save_model(small_model(), path);
  save_model(small_model(), path);
  expect_same(load_model(path), small_model());
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(folder), {}), 1) << "no temporary file stays";
  Model bad = small_model();
  bad.encoder[0][0].weight[0] = NAN;
  EXPECT_THROW(save_model(bad, path), Error);
  expect_same(load_model(path), small_model());

  const auto io = [](auto act, const char* piece) {
    try {
      act();
      ADD_FAILURE() << "no error: " << piece;
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), ErrorCode::io);
      EXPECT_NE(std::string(e.what()).find(piece), std::string::npos) << e.what();
    }
  };
  io([&] { load_model(folder / "none.safetensors"); }, "none.safetensors");
  io([&] { load_model(folder); }, folder.c_str());
  io([&] { load_model("/dev/zero"); }, "/dev/zero");
  io([&] { save_model(small_model(), folder / "no/such/folder/m.safetensors"); }, "no/such/folder");
  std::filesystem::resize_file(path, 100);
  EXPECT_NE(refusal([&] { load_model(path); }).find(path), std::string::npos);
  std::filesystem::resize_file(path, uintmax_t{1} << 40);
  expect_says(refusal([&] { load_model(path); }), {path.c_str(), "1099511627776"});
  std::filesystem::remove_all(folder);
}

TEST(ModelFile, EveryTruncationIsAnError) {
  const std::vector<uint8_t> bytes = model_bytes(small_model());
  for (size_t n = 0; n < bytes.size(); ++n)
    EXPECT_NE(refusal([&] { parse_model(std::span(bytes).first(n), "m"); }), "no error") << n << " bytes";
  std::vector<uint8_t> longer = bytes;
  longer.push_back(0);
  expect_refused(longer, {"bytes of data, but its tensors describe"});
}

TEST(ModelFile, HeadersThatLie) {
  const auto file = [](const std::string& header, size_t data, uint64_t size) {
    std::vector<uint8_t> bytes(8 + header.size() + data);
    std::memcpy(bytes.data(), &size, 8);
    std::memcpy(bytes.data() + 8, header.data(), header.size());
    return bytes;
  };
  const auto expect = [&](const std::string& header, size_t data, std::initializer_list<const char*> pieces) {
    expect_refused(file(header, data, header.size()), pieces);
  };
  expect_refused(file("{}", 0, std::numeric_limits<uint64_t>::max()), {"18446744073709551615"});
  expect_refused(file(std::string(1 << 19, ' '), 0, 1 << 19), {"header of 524288 bytes"});
  expect("", 0, {"the end instead of a value"});
  expect("[]", 0, {"not a JSON object"});
  expect(std::string(3000, '['), 0, {"nested at most 4 levels deep"});
  const auto entry = [](const std::string& inside) { return "{\"a\":{" + inside + "}}"; };
  expect(entry(R"("dtype":"F16","shape":[2],"data_offsets":[0,4])"), 4, {"'a'", "'F16'", "single precision"});
  expect(entry(R"("dtype":"BF16","shape":[2],"data_offsets":[0,4])"), 4, {"'BF16'"});
  expect(entry(R"("dtype":"F32","shape":[2],"data_offsets":[0,4])"), 8, {"needs 8 bytes", "0 to 4"});
  expect(entry(R"("dtype":"F32","shape":[1],"data_offsets":[4,0])"), 8, {"4 to 0"});
  expect(entry(R"("dtype":"F32","shape":[1],"data_offsets":[4,8])"), 8, {"begins at byte 4", "after a gap"});
  expect(entry(R"("dtype":"F32","shape":[1],"data_offsets":[0,4])"), 8, {"has 8 bytes of data", "describe 4"});
  expect(entry(R"("dtype":"F32","shape":[9],"data_offsets":[0,36])"), 8, {"an integer from 0 to 8"});
  expect(entry(R"("dtype":"F32","shape":[-1],"data_offsets":[0,4])"), 8, {"-1"});
  expect(entry(R"("dtype":"F32","shape":[1.5],"data_offsets":[0,4])"), 8, {"1.5"});
  expect(entry(R"("dtype":"F32","shape":[1,1,1,1,1,1,1,1,1],"data_offsets":[0,4])"), 4, {"at most 8"});
  expect(entry(R"("dtype":"F32","shape":[400,400,400,400,400,400,400,400],"data_offsets":[0,4])"), 400, {"too many elements"});
  expect(entry(R"("dtype":"F32","shape":[1])"), 4, {"dtype, shape and data_offsets"});
  expect(entry(R"("dtype":"F32","shape":[1],"data_offset":[0,4])"), 4, {"has no data_offsets"});
  const std::string four = R"({"dtype":"F32","shape":[1],"data_offsets":[0,4]})";
  expect("{\"a\":" + four + ",\"b\":" + four + "}", 4, {"'b'", "inside the tensor before it"});
  expect("{\"a\":" + four + ",\"a\":" + four + "}", 4, {"'a' appears twice"});
  expect(R"({"__metadata__":{"format":1}})", 0, {"'format' must be a string"});
}

/// The file of a good model after a change to its content.
std::vector<uint8_t> changed(const std::function<void(Safetensors&)>& change) {
  Safetensors content = content_of(small_model());
  change(content);
  return internal::safetensors_bytes(content);
}

std::vector<uint8_t> with_metadata(const std::string& key, const std::string& value) {
  return changed([&](Safetensors& file) {
    std::erase_if(file.metadata, [&](const auto& entry) { return entry.first == key; });
    file.metadata.emplace_back(key, value);
  });
}

TEST(ModelFile, MetadataMustFit) {
  for (const char* key : {"format", "name", "licence", "provenance", "encoder_channels", "encoder_dilations", "mean", "std",
                          "input_channels", "activation", "patch", "iterations", "damping", "m_estimator_channels"})
    expect_refused(changed([&](Safetensors& file) { std::erase_if(file.metadata, [&](auto& e) { return e.first == key; }); }),
                   {key, "missing"});
  expect_refused(with_metadata("format", "pt"), {"format is 'pt'", "iclk-model-1"});
  expect_refused(with_metadata("activation", "relu"), {"activation is 'relu'", "'elu'"});
  expect_refused(with_metadata("normalisation", "batch"), {"normalisation is 'batch'", "fixed or image"});
  expect_refused(with_metadata("patch", "16"), {"patch is '16'", "'8'"});
  expect_refused(with_metadata("name", ""), {"name"});
  expect_refused(with_metadata("name", "\x1b[2J"), {"name", "control characters"});
  expect_refused(with_metadata("input_channels", "2"), {"input_channels must be 3 (RGB) or 1"});
  expect_refused(with_metadata("mean", "[1,2]"), {"'mean' must be a list of 3"});
  expect_refused(with_metadata("mean", "[1,2,\"3\"]"), {"'mean' must have numbers"});
  expect_refused(with_metadata("mean", "[1,2,1e400]"), {"'mean'", "double precision"});
  expect_refused(with_metadata("std", "[1,1,0]"), {"std of channel 2 is 0"});
  expect_refused(with_metadata("iterations", "0"), {"iterations is 0", "1 to 100"});
  expect_refused(with_metadata("iterations", "1e9"), {"iterations is 1e+09"});
  expect_refused(with_metadata("damping", "-1"), {"damping is -1"});
  expect_refused(with_metadata("carry", "2"), {"carry is 2", "0 to 1"});
  expect_refused(with_metadata("carry", "x"), {"'carry'"});
  expect_refused(with_metadata("encoder_channels", "[[2,3],[4]"), {"'encoder_channels'", "the end"});
  expect_refused(with_metadata("encoder_channels", "[[2,3]]"), {"1 levels, encoder_dilations 2"});
  expect_refused(with_metadata("encoder_channels", "[[2],[4]]"), {"the same lengths"});
  expect_refused(with_metadata("encoder_channels", "[[2,3],[5]]"), {"encoder.2.weight", "4x3x3x3", "5x3x3x3"});
  expect_refused(with_metadata("encoder_channels", "[[2,3],[4096]]"), {"4096", "1024"});
  expect_refused(with_metadata("encoder_channels", "[[2,3],[]]"), {"1 to 16 numbers"});
  expect_refused(with_metadata("encoder_channels", "[]"), {"1 to 12 lists"});
  expect_refused(with_metadata("encoder_channels", "[[[2]]]"), {"nested at most "});
  expect_refused(with_metadata("encoder_dilations", "[[1,0],[1]]"), {"dilation of encoder level 0 layer 1 is 0"});
  expect_refused(with_metadata("m_estimator_channels", "[4,8,16,2]"), {"m_estimator.3.weight", "2x16x3x3"});
}

TEST(ModelFile, TensorsMustBeThoseOfTheArchitecture) {
  expect_refused(changed([](Safetensors& file) { file.tensors.erase(file.tensors.begin() + 2); }),
                 {"'encoder.1.weight' of shape 3x2x3x3 is missing"});
  expect_refused(changed([](Safetensors& file) {
                   file.tensors.push_back({"extra", {1}, {0}});
                 }),
                 {"'extra'", "none of the layers"});
  expect_refused(changed([](Safetensors& file) { file.tensors[1].data[0] = NAN; }), {"encoder level 0 layer 0", "NaN"});
  expect_refused(changed([](Safetensors& file) {
                   file.tensors[0].shape = {3, 2, 3, 3};
                 }),
                 {"'encoder.0.weight' has the shape 3x2x3x3", "2x3x3x3"});
}

TEST(ModelFile, UnknownMetadataAreLeftAlone) {
  expect_same(parse_model(changed([](Safetensors& file) { file.metadata.emplace_back("trained_on", "a cluster"); }), "m"),
              small_model());
}

TEST(Json, IsStrict) {
  const internal::Json all =
      internal::parse_json(R"( {"a": [1, -2.5e3, 0], "b": {"c": null}, "d": true, "e": "\u00e9\ud83d\ude00\n"} )", 3);
  EXPECT_EQ(all.find("a")->items[1].number, -2500);
  EXPECT_EQ(all.find("b")->find("c")->kind, internal::Json::Kind::null);
  EXPECT_TRUE(all.find("d")->boolean);
  EXPECT_EQ(all.find("e")->string, "\xc3\xa9\xf0\x9f\x98\x80\n");
  EXPECT_EQ(all.find("f"), nullptr);
  for (const char* text : {"",
                           "{",
                           "[1,]",
                           "[1 2]",
                           "{\"a\"}",
                           "{\"a\":1,}",
                           "{a:1}",
                           "01",
                           "1.",
                           ".5",
                           "+1",
                           "1e",
                           "nan",
                           "inf",
                           "tru",
                           "'a'",
                           "\"a",
                           "\"\t\"",
                           "\"\\x\"",
                           "\"\\u12\"",
                           "\"\\ud800\"",
                           "\"\\udc00\"",
                           "\"\\ud800\\u0041\"",
                           "\"\xff\"",
                           "\"\xc3\"",
                           "\"\xc0\x80\"",
                           "\"\xed\xa0\x80\"",
                           "\"\xf4\x90\x80\x80\"",
                           "1 1",
                           "{} x",
                           "1e999",
                           "-",
                           "[",
                           "]",
                           "\"\\u-123\""})
    EXPECT_NE(refusal([&] { internal::parse_json(text, 3); }), "no error") << text;
  EXPECT_NE(refusal([] { internal::parse_json("[[[[]]]]", 3); }), "no error");
  EXPECT_EQ(internal::parse_json(internal::json_string("\x01\"\\/\n\xc3\xa9"), 1).string, "\x01\"\\/\n\xc3\xa9");
}

}  // namespace
}  // namespace iclk
