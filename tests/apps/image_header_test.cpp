// What is known of an image before it is decoded: its size, and whether it is whole.
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <opencv2/imgcodecs.hpp>

#include "apps/iclk/io/images.h"
#include "files.h"

namespace iclk {
namespace {

using test::bytes_of;
using test::expect_error;
using test::Folder;

cv::Mat noise(int type, int width = 40, int height = 30) {
  cv::Mat m(height, width, type);
  cv::randu(m, 0, CV_MAT_DEPTH(type) == CV_8U ? 255 : 60000);
  return m;
}

TEST(ImageHeaders, SayWhatIsDecoded) {
  const Folder folder;
  const std::vector<std::pair<std::string, std::vector<int>>> formats = {
      {"png", {CV_8UC1, CV_8UC3, CV_8UC4, CV_16UC1, CV_16UC3, CV_16UC4}},
      {"jpg", {CV_8UC1, CV_8UC3}},
      {"tiff", {CV_8UC1, CV_8UC3, CV_16UC1, CV_16UC3, CV_32FC1, CV_32FC3, CV_64FC1}},
      {"exr", {CV_32FC1, CV_32FC3}},
      {"bmp", {CV_8UC3}},
      {"webp", {CV_8UC3}},
      {"pgm", {CV_8UC1, CV_16UC1}},
      {"ppm", {CV_8UC3, CV_16UC3}},
      {"pam", {CV_8UC1, CV_8UC3}},
      {"pfm", {CV_32FC1, CV_32FC3}},
      {"hdr", {CV_32FC3}},
      {"ras", {CV_8UC3}}};
  for (const auto& [format, types] : formats)
    for (const int type : types) {
      const std::string path = folder.path("a." + format);
      ASSERT_TRUE(cv::imwrite(path, noise(type))) << format;
      const cv::Mat decoded = cv::imread(path, cv::IMREAD_UNCHANGED);
      const auto header = peek_image(path);
      ASSERT_TRUE(header) << format << " " << type;
      EXPECT_EQ(header->width, 40u) << format;
      EXPECT_EQ(header->height, 30u) << format;
      EXPECT_GE(header->pixel_bytes, decoded.elemSize()) << format << " " << type;
      EXPECT_LE(header->pixel_bytes, 3 * decoded.elemSize()) << format << " " << type;
      EXPECT_NO_THROW(load_image(path, 1200)) << format;
      for (const auto load :
           {+[](const std::string& p) { load_image(p, 1199); }, +[](const std::string& p) { load_depth(p, 1, 1199); },
            +[](const std::string& p) { peek_image(p, 1199); }})
        expect_error([&] { load(path); }, ErrorCode::invalid_argument,
                     {path.c_str(), "40x30", "--set max-pixels allows 1199 pixels"});
    }
}

#ifndef __SANITIZE_ADDRESS__  // which takes more memory by itself than the test allows
TEST(ImageHeaders, ABombIsRefusedBeforeItTakesMemory) {
  const Folder folder;
  cv::imwrite(folder.path("bomb.png"), cv::Mat::zeros(10000, 10000, CV_16UC4), {cv::IMWRITE_PNG_COMPRESSION, 1});
  EXPECT_LT(std::filesystem::file_size(folder.path("bomb.png")), 8u << 20);
  const pid_t child = fork();
  if (child == 0) {
    const rlimit limit = {size_t{600} << 20, size_t{600} << 20};
    setrlimit(RLIMIT_DATA, &limit);
    bool refused = false;
    try {
      load_image(folder.path("bomb.png"));
    } catch (const Error& e) {
      refused = std::string(e.what()).find("bomb.png is 10000x10000, but --set max-pixels allows") != std::string::npos;
    }
    _exit(refused ? 0 : 1);
  }
  int status = 0;
  waitpid(child, &status, 0);
  EXPECT_EQ(status, 0);
}
#endif

TEST(ImageHeaders, UnknownFilesSayNothing) {
  const Folder folder;
  for (const std::string& bytes :
       {std::string(), std::string("P"), std::string("P6 x y"), std::string("\x89PNG\r\n\x1a\n"), std::string("\xff\xd8\xff"),
        std::string("\x76\x2f\x31\x01 abc"), std::string("#?RADIANCE\n\n-Y"), std::string("II*"), std::string("hello")})
    EXPECT_FALSE(peek_image(folder.write("x", bytes))) << bytes;
  EXPECT_FALSE(peek_image(folder.path("missing")));
  EXPECT_FALSE(peek_image(folder.path("")));
}

class Jpegs : public ::testing::Test {
 protected:
  static std::string jpeg(std::vector<int> options) {
    std::vector<uchar> bytes;
    cv::imencode(".jpg", noise(CV_8UC3, 200, 160), bytes, options);
    return {bytes.begin(), bytes.end()};
  }
  const std::vector<std::string> images_ = {jpeg({}), jpeg({cv::IMWRITE_JPEG_PROGRESSIVE, 1}),
                                            jpeg({cv::IMWRITE_JPEG_RST_INTERVAL, 4})};
  Folder folder_;
};

TEST_F(Jpegs, MayHaveAFilmBehindTheirEnd) {
  const std::string film = std::string(
                               "\0\0\0\x18"
                               "ftypmp42",
                               12) +
                           std::string(5000, 'x');
  const std::vector<std::string> tails = {film,
                                          film + "\xff\xd9" + film,
                                          film + "\xff\xd8" + film,
                                          film + "\xff\xda" + film,
                                          film + "\xff\xd8\xff\xda" + film + "\xff\xd9",
                                          "\xff\xda",
                                          "\xff",
                                          std::string(1, '\0')};
  for (const std::string& image : images_)
    for (const std::string& tail : tails)
      EXPECT_EQ(load_image(folder_.write("motion.jpg", image + tail)).size(), cv::Size(200, 160)) << tail.substr(0, 20);
}

TEST_F(Jpegs, AreRefusedWhereverTheyAreCut) {
  for (const std::string& image : images_) {
    EXPECT_FALSE(is_truncated_jpeg(image));
    for (size_t size = 2; size < image.size(); ++size)
      ASSERT_TRUE(is_truncated_jpeg(std::string_view(image).substr(0, size))) << size << " of " << image.size();
    expect_error([&] { load_image(folder_.write("cut.jpg", image.substr(0, image.size() / 2))); }, ErrorCode::io,
                 {"cut.jpg", "truncated"});
  }
}

TEST_F(Jpegs, AThumbnailsEndIsNotTheirs) {
  // As cameras write it: a whole JPEG in an application segment, before the image itself.
  const std::string thumbnail = images_[0].substr(0, 2) +
                                "\xff\xda"
                                "data\xff\xd9";
  const std::string segment = std::string("\xff\xe1\0", 3) + static_cast<char>(thumbnail.size() + 2) + thumbnail;
  const std::string image = images_[0].substr(0, 2) + segment + images_[0].substr(2);
  EXPECT_EQ(load_image(folder_.write("camera.jpg", image)).size(), cv::Size(200, 160));
  expect_error([&] { load_image(folder_.write("cut.jpg", image.substr(0, image.size() - 100))); }, ErrorCode::io,
               {"cut.jpg", "truncated"});
  const auto header = image_header(image);
  ASSERT_TRUE(header);
  EXPECT_EQ(header->width, 200u);
}

}  // namespace
}  // namespace iclk
