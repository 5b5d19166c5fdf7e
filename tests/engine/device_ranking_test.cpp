#include <iclk/engine/device_ranking.h>

#include <vector>

#include <gtest/gtest.h>

#include <iclk/engine/error.h>

namespace iclk::engine {
namespace {

DeviceInfo device(const std::string& name, DeviceType type, const std::string& rejected = "") {
  DeviceInfo info;
  info.name = name;
  info.type = type;
  info.rejected = rejected;
  for (size_t i = 0; i < info.uuid.size(); ++i) info.uuid[i] = static_cast<uint8_t>(name.size() * 16 + i);
  return info;
}

const std::vector<DeviceInfo> machine{
    device("llvmpipe (LLVM 15.0.6, 256 bits)", DeviceType::cpu), device("Virtio-GPU Venus", DeviceType::virtual_gpu),
    device("Intel(R) UHD Graphics 770", DeviceType::integrated), device("NVIDIA GeForce RTX 4090", DeviceType::discrete),
    device("AMD Radeon RX 7900", DeviceType::discrete),          device("Strange", DeviceType::other),
};

/// The message of the Error(no_device) that a request ends in.
std::string refusal(const std::vector<DeviceInfo>& devices, std::string_view request) {
  try {
    choose_device(devices, request);
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::no_device);
    return error.what();
  }
  ADD_FAILURE() << "'" << request << "' was accepted";
  return {};
}

TEST(ChooseDevice, RanksByTypeAndKeepsTheOrderOfEquals) {
  std::vector<DeviceInfo> devices = machine;
  for (const char* expected : {"NVIDIA GeForce RTX 4090", "AMD Radeon RX 7900", "Intel(R) UHD Graphics 770", "Virtio-GPU Venus",
                               "llvmpipe (LLVM 15.0.6, 256 bits)", "Strange"}) {
    const DeviceChoice choice = choose_device(devices, "");
    EXPECT_EQ(devices[choice.index].name, expected);
    EXPECT_EQ(choice.cpu_unasked, devices[choice.index].type == DeviceType::cpu);
    devices.erase(devices.begin() + static_cast<std::ptrdiff_t>(choice.index));
  }
}

TEST(ChooseDevice, SkipsTheRejected) {
  std::vector<DeviceInfo> devices = machine;
  devices[3].rejected = "Vulkan 1.0.3, needs 1.1.0";
  EXPECT_EQ(choose_device(devices, "").index, 4u);
  EXPECT_NE(refusal(devices, "4090").find("needs 1.1.0"), std::string::npos);
  EXPECT_NE(refusal(devices, "3").find("no usable device matches '3'"), std::string::npos);
}

TEST(ChooseDevice, ByIndex) {
  for (size_t i = 0; i < machine.size(); ++i) EXPECT_EQ(choose_device(machine, std::to_string(i)).index, i);
  EXPECT_FALSE(choose_device(machine, "0").cpu_unasked);
  EXPECT_EQ(choose_device(machine, " 2 ").index, 2u);
  refusal(machine, "6");  // not the 6 of "256 bits"
  refusal(machine, "-1");
  refusal(machine, "99999999999999999999");
}

TEST(ChooseDevice, ByPartOfTheNameInAnyCase) {
  EXPECT_EQ(choose_device(machine, "radeon").index, 4u);
  EXPECT_EQ(choose_device(machine, "UHD graphics").index, 2u);
  EXPECT_EQ(choose_device(machine, "4090").index, 3u) << "digits beyond the count are a name";
  const DeviceChoice asked = choose_device(machine, "LLVMpipe");
  EXPECT_EQ(asked.index, 0u);
  EXPECT_FALSE(asked.cpu_unasked);
}

TEST(ChooseDevice, OfSeveralMatchesTheBestUsable) {
  std::vector<DeviceInfo> devices{device("Foo 1", DeviceType::cpu), device("Foo 2", DeviceType::discrete, "broken"),
                                  device("Foo 3", DeviceType::integrated), device("Foo 4", DeviceType::integrated)};
  EXPECT_EQ(choose_device(devices, "foo").index, 2u);
}

TEST(ChooseDevice, ByUuidWithAndWithoutDashes) {
  const std::string text = uuid_text(machine[2].uuid);
  EXPECT_EQ(text, "90919293-9495-9697-9899-9a9b9c9d9e9f");  // 25 characters: 0x90 onwards
  std::string bare, upper;
  for (char c : text) {
    if (c != '-') bare += c;
    upper += static_cast<char>(std::toupper(c));
  }
  EXPECT_EQ(choose_device(machine, text).index, 2u);
  EXPECT_EQ(choose_device(machine, bare).index, 2u);
  EXPECT_EQ(choose_device(machine, upper).index, 2u);
  bare.back() = '0';
  refusal(machine, bare);
  EXPECT_EQ(choose_device(machine, "GPU-" + text).index, 2u);  // as nvidia-smi writes it
  refusal(machine, text.substr(0, 8));                         // part of a UUID is none, and no name
}

TEST(ChooseDevice, ARefusalListsEveryDevice) {
  const std::string message = refusal(machine, "foo");
  EXPECT_EQ(message.find("no device matches 'foo'; devices: 0 llvmpipe (LLVM 15.0.6, 256 bits) [cpu]; 1 "), 0u) << message;
  for (const DeviceInfo& info : machine) EXPECT_NE(message.find(info.name), std::string::npos);
  EXPECT_EQ(refusal({}, ""), "no Vulkan device; devices: none");
  EXPECT_EQ(refusal({}, "0"), "no device matches '0'; devices: none");
  EXPECT_NE(refusal({device("Old", DeviceType::discrete, "too old")}, "").find("0 Old [discrete] rejected: too old"),
            std::string::npos);
}

}  // namespace
}  // namespace iclk::engine
