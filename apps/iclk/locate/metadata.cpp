#include "apps/iclk/locate/metadata.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <memory>
#include <vector>

#include <cpl_error.h>
#include <cpl_minixml.h>
#include <gdal.h>
#include <Eigen/Geometry>

#include <iclk/session/io/distortion.h>
#include <iclk/session/io/text.h>

#include "apps/iclk/common/angles.h"
#include "apps/iclk/locate/priors.h"

namespace iclk {
namespace {

using Tags = std::map<std::string, std::string>;

/// "+92.0", "-9000/100". Nothing for what is not finite.
std::optional<double> number_of(std::string_view text) {
  text = trim(text);
  if (text.starts_with('+')) text.remove_prefix(1);
  const size_t bar = text.find('/');
  const auto value = to_number(text.substr(0, bar));
  const auto over = bar == std::string_view::npos ? std::optional(1.0) : to_number(text.substr(bar + 1));
  if (!value || !over || !std::isfinite(*value / *over)) return std::nullopt;
  return *value / *over;
}

std::string tag(const Tags& tags, const std::string& name) {
  const auto found = tags.find(name);
  return found == tags.end() ? "" : found->second;
}

std::optional<double> number_of(const Tags& tags, const std::string& name) { return number_of(tag(tags, name)); }

/// Numbers that are all there.
std::optional<Eigen::Vector3d> numbers_of(const Tags& tags, const std::string& a, const std::string& b, const std::string& c) {
  const auto x = number_of(tags, a), y = number_of(tags, b), z = number_of(tags, c);
  return x && y && z ? std::optional(Eigen::Vector3d(*x, *y, *z)) : std::nullopt;
}

/// Attributes and elements with a text, by their names without prefix, and those of Pix4D as "Camera:name".
void collect(const CPLXMLNode* node, Tags& tags, std::map<std::string, bool>& camera, int depth = 0) {
  if (depth > 20) return;
  for (; node != nullptr; node = node->psNext) {
    const std::string name = node->pszValue;
    const size_t colon = name.find(':');
    const CPLXMLNode* const child = node->psChild;
    if ((node->eType == CXT_Attribute || node->eType == CXT_Element) && colon != std::string::npos) {
      const CPLXMLNode* text = child;
      while (text != nullptr && text->eType != CXT_Text) text = text->psNext;
      const std::string prefix = name.substr(0, colon), local = name.substr(colon + 1);
      if (text != nullptr && prefix == "xmlns" &&
          std::string_view(text->pszValue).find("pix4d.com/camera") != std::string::npos)
        camera[local] = true;
      else if (text != nullptr && prefix != "xmlns")
        tags.emplace((camera.contains(prefix) ? "Camera:" : "") + local, text->pszValue);
    }
    if (node->eType == CXT_Element) collect(child, tags, camera, depth + 1);
  }
}

Tags xmp_of(GDALDatasetH file) {
  char** const packet = GDALGetMetadata(file, "xml:XMP");
  Tags tags;
  if (packet == nullptr || packet[0] == nullptr) return tags;
  const std::unique_ptr<CPLXMLNode, decltype(&CPLDestroyXMLNode)> tree(CPLParseXMLString(packet[0]), &CPLDestroyXMLNode);
  std::map<std::string, bool> camera = {{"Camera", true}};
  collect(tree.get(), tags, camera);
  return tags;
}

/// GDAL's names are those of EXIF with EXIF_ before them.
Tags exif_of(GDALDatasetH file) {
  Tags tags;
  for (const char* domain : {"EXIF", ""})
    for (char** line = GDALGetMetadata(file, domain); line != nullptr && *line != nullptr; ++line)
      if (const std::string_view text = *line; text.starts_with("EXIF_") && text.find('=') != std::string_view::npos)
        tags.emplace(text.substr(5, text.find('=') - 5), text.substr(text.find('=') + 1));
  return tags;
}

/// "(48) (8) (14.6)".
std::vector<double> rationals(const Tags& tags, const std::string& name) {
  std::vector<double> values;
  for (const std::string& word : split_words(tag(tags, name), " ()")) values.push_back(number_of(word).value_or(NAN));
  return values;
}

/// NaN for what is no angle.
double degrees(const Tags& exif, const std::string& name, const std::string& positive, const std::string& negative) {
  const std::vector<double> parts = rationals(exif, name);
  const std::string ref = tag(exif, name + "Ref");
  const std::string_view side = trim(ref);
  if (parts.size() != 3 || (side != positive && side != negative)) return NAN;
  if (!(parts[0] >= 0 && parts[1] >= 0 && parts[1] <= 60 && parts[2] >= 0 && parts[2] <= 60)) return NAN;
  return (side == negative ? -1 : 1) * (parts[0] + parts[1] / 60 + parts[2] / 3600);
}

void find_place(const Tags& exif, const Tags& xmp, PictureMetadata& found) {
  Eigen::Vector2d at(degrees(exif, "GPSLatitude", "N", "S"), degrees(exif, "GPSLongitude", "E", "W"));
  found.lat_lon_from = "EXIF";
  auto longitude = number_of(xmp, "GpsLongitude");
  if (!longitude) longitude = number_of(xmp, "GpsLongtitude");  // as older drones spell it
  if (const auto latitude = number_of(xmp, "GpsLatitude"); latitude && longitude)
    at = {*latitude, *longitude}, found.lat_lon_from = "GpsLatitude";
  if (tag(exif, "GPSStatus") == "V" || tag(xmp, "GpsStatus") == "Invalid")
    found.no_place = "it states that its GPS had no fix";
  else if (found.lat_lon_from == "EXIF" && tag(exif, "GPSLatitude").empty())
    found.no_place = "it has no GPS position";
  else if (!at.allFinite() || std::abs(at.x()) > 90 || std::abs(at.y()) > 180)
    found.no_place = "its GPS position is no latitude and longitude";
  else if (at.isZero())
    found.no_place = "its GPS position is 0, 0, which is what receivers write without a fix";
  else
    found.lat_lon = at;
}

void find_heights(const Tags& exif, const Tags& xmp, PictureMetadata& found) {
  found.altitude = number_of(xmp, "AbsoluteAltitude"), found.altitude_from = "AbsoluteAltitude";
  found.height = number_of(xmp, "RelativeAltitude"), found.height_from = "RelativeAltitude";
  if (!found.height) found.height = number_of(xmp, "Camera:AboveGroundAltitude"), found.height_from = "AboveGroundAltitude";
  const std::vector<double> altitude = rationals(exif, "GPSAltitude");
  if (found.altitude || altitude.size() != 1 || !std::isfinite(altitude[0])) return;
  const std::string reference = tag(exif, "GPSAltitudeRef");  // 0x01: below the sea; 0x02, 0x03: from the ellipsoid
  const char kind = reference.empty() ? '0' : reference.back();
  found.altitude = (kind == '1' || kind == '3' ? -1 : 1) * altitude[0], found.altitude_from = "GPSAltitude";
  found.ellipsoid = kind == '2' || kind == '3';
}

/// From the angles of a body (x ahead, y right, z down) below which a camera looks down, the top of its picture ahead.
Eigen::Matrix3d from_body(const Eigen::Vector3d& yaw_pitch_roll) {
  using Eigen::AngleAxisd;
  using Eigen::Vector3d;
  const Vector3d a = yaw_pitch_roll * kDegree;
  Eigen::Matrix3d to_east_north_up, to_body;
  to_east_north_up << 0, 1, 0, 1, 0, 0, 0, 0, -1;
  to_body << 0, -1, 0, 1, 0, 0, 0, 0, 1;
  return to_east_north_up *
         (AngleAxisd(a[0], Vector3d::UnitZ()) * AngleAxisd(a[1], Vector3d::UnitY()) * AngleAxisd(a[2], Vector3d::UnitX()))
             .toRotationMatrix() *
         to_body;
}

void find_attitude(const Tags& exif, const Tags& xmp, PictureMetadata& found) {
  for (const std::string of : {"Gimbal", "Camera"})  // pitch up from the horizon
    if (const auto angles = numbers_of(xmp, of + "YawDegree", of + "PitchDegree", of + "RollDegree")) {
      found.attitude_from = of + "YawDegree", found.R_WC = from_yaw_pitch_roll(*angles);
      return;
    }
  auto angles = numbers_of(xmp, "Camera:Yaw", "Camera:Pitch", "Camera:Roll");
  std::string make = tag(exif, "Make");
  std::transform(make.begin(), make.end(), make.begin(), [](unsigned char c) { return std::tolower(c); });
  // These makers count the pitch from straight down.
  const bool known =
      make.starts_with("sensefly") || make.starts_with("autel") || make.starts_with("sentera") || make.starts_with("micasense");
  if (!angles)
    found.no_attitude = "it has no attitude";
  else if (!known)
    found.no_attitude = "its XMP has Camera:Pitch, and iclk cannot tell from where '" + printable(make) + "' counts it";
  else {
    if (make.starts_with("sensefly")) (*angles)[2] *= -1;
    found.attitude_from = "Camera:Yaw", found.R_WC = from_body(*angles);
  }
}

/// DJI's "date;fx,fy,cx,cy,k1,k2,p1,p2,k3", the centre against the middle of the picture.
void find_camera(const std::string& path, const Tags& xmp, int columns, int rows, PictureMetadata& found) {
  const std::string data = tag(xmp, "DewarpData"), flag = tag(xmp, "DewarpFlag");
  if (data.find(';') == std::string::npos) return;
  std::vector<double> k;
  for (const std::string& cell : split_cells(data.substr(data.find(';') + 1))) k.push_back(number_of(cell).value_or(NAN));
  const bool finite = std::all_of(k.begin(), k.end(), [](double v) { return std::isfinite(v); });
  const double width = columns, height = rows;
  // A picture that was made smaller keeps what it states of the large one.
  const double middle = number_of(xmp, "CalibratedOpticalCenterX").value_or(width / 2);
  found.no_camera = "the calibration of its camera (DewarpData) cannot be used for a picture of this size";
  if (k.size() != 9 || !finite || (flag != "0" && flag != "1") || std::abs(middle - width / 2) > 0.1 * width ||
      !(k[0] > width / 4 && k[0] < 20 * width && std::abs(k[1] / k[0] - 1) < 0.1) || std::abs(k[2]) > width / 10 ||
      std::abs(k[3]) > height / 10)
    return;
  CameraFile& camera = found.camera.emplace();
  camera.camera = {k[0], k[1], (width - 1) / 2 + k[2], (height - 1) / 2 + k[3], columns, rows};
  if (flag == "0") camera.distortion = make_distortion("radtan", {k[4], k[5], k[6], k[7], k[8]}, path);
  camera.source = path;
  found.no_camera.clear();
}

}  // namespace

PictureMetadata read_metadata(const std::string& path) {
  static const bool registered = (GDALAllRegister(), true);
  (void)registered;
  CPLPushErrorHandler(CPLQuietErrorHandler);
  PictureMetadata found;
  struct Closer {
    void operator()(void* open) const { GDALClose(open); }
  };
  const std::unique_ptr<void, Closer> file(GDALOpenEx(path.c_str(), GDAL_OF_RASTER, nullptr, nullptr, nullptr));
  const Tags exif = file ? exif_of(file.get()) : Tags(), xmp = file ? xmp_of(file.get()) : Tags();
  CPLPopErrorHandler();
  find_place(exif, xmp, found);
  find_heights(exif, xmp, found);
  find_attitude(exif, xmp, found);
  if (file) find_camera(path, xmp, GDALGetRasterXSize(file.get()), GDALGetRasterYSize(file.get()), found);
  return found;
}

}  // namespace iclk
