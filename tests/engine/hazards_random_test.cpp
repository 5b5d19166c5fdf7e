// Random recordings against a checker that knows nothing of HazardTracker: it walks every pair of commands that meet in a
// resource, along the barriers between them, by the words of the specification (execution dependency chains, availability,
// visibility).
#include <random>
#include <vector>

#include <gtest/gtest.h>

#include <iclk/engine/compute/hazards.h>

namespace iclk::engine {
namespace {

struct Access {
  VkPipelineStageFlags stage;
  VkAccessFlags read, write;
};

Access access_of(Stage stage) {
  switch (stage) {
    case Stage::compute: return {VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT, VK_ACCESS_SHADER_READ_BIT, VK_ACCESS_SHADER_WRITE_BIT};
    case Stage::transfer: return {VK_PIPELINE_STAGE_TRANSFER_BIT, VK_ACCESS_TRANSFER_READ_BIT, VK_ACCESS_TRANSFER_WRITE_BIT};
    case Stage::host: break;
  }
  return {VK_PIPELINE_STAGE_HOST_BIT, VK_ACCESS_HOST_READ_BIT, 0};
}

struct Command {
  Stage stage;
  std::vector<Use> uses;
  std::optional<Barrier> barrier;  // before it
};

bool uses(const Command& command, uint64_t resource, bool write) {
  for (const Use& use : command.uses)
    if (use.resource == resource && use.write == write) return true;
  return false;
}

/// Whether what `from` does with a resource is over, and where it wrote visible, when `to` touches it.
bool ordered(const std::vector<Command>& commands, size_t from, size_t to, bool from_writes, bool to_reads, bool to_writes) {
  const Access first = access_of(commands[from].stage), second = access_of(commands[to].stage);
  VkPipelineStageFlags after = 0;  // stages that wait for `from`
  bool available = false;
  VkAccessFlags visible = 0;  // to the stage of `to`
  for (size_t k = from + 1; k <= to; ++k) {
    if (!commands[k].barrier) continue;
    const Barrier& b = *commands[k].barrier;
    if (!(b.source_stages & (first.stage | after))) continue;
    if ((b.source_stages & first.stage) && (b.source_access & first.write)) available = true;
    if (available && (b.destination_stages & second.stage)) visible |= b.destination_access;
    after |= b.destination_stages;
  }
  if (!(after & second.stage)) return false;
  if (!from_writes) return true;
  return (!to_reads || (visible & second.read)) && (!to_writes || (visible & second.write));
}

int hazards(const std::vector<Command>& commands, uint64_t resources) {
  int found = 0;
  for (size_t j = 0; j < commands.size(); ++j)
    for (size_t i = 0; i < j; ++i)
      for (uint64_t r = 0; r < resources; ++r) {
        const bool i_writes = uses(commands[i], r, true), i_reads = uses(commands[i], r, false);
        const bool j_writes = uses(commands[j], r, true), j_reads = uses(commands[j], r, false);
        if (i_writes && (j_reads || j_writes)) found += !ordered(commands, i, j, true, j_reads, j_writes);
        if (i_reads && j_writes) found += !ordered(commands, i, j, false, j_reads, j_writes);
      }
  return found;
}

/// Commands of a recording, in a random order, each as the tracker has it.
std::vector<Command> random_recording(std::mt19937& random, size_t length, uint64_t resources) {
  const auto below = [&](uint64_t n) { return static_cast<uint64_t>(random() % n); };
  HazardTracker tracker;
  std::vector<Command> commands;
  for (size_t k = 0; k < length; ++k) {
    Command c{below(3) ? Stage::compute : Stage::transfer, {}, {}};
    const uint64_t count = c.stage == Stage::transfer ? 2 : 1 + below(4);
    for (uint64_t u = 0; u < count; ++u) c.uses.push_back({below(resources), below(2) == 0});
    commands.push_back(std::move(c));
  }
  Command last{Stage::host, {}, {}};
  for (uint64_t r = 0; r < resources; ++r)
    if (below(2)) last.uses.push_back({r, false});
  commands.push_back(std::move(last));
  for (Command& c : commands) c.barrier = tracker.before(c.stage, c.uses);
  return commands;
}

TEST(HazardsAtRandom, NoTwoCommandsMeetUnordered) {
  std::mt19937 random(1);
  size_t barriers = 0;
  for (int i = 0; i < 2000; ++i) {
    const uint64_t resources = 1 + random() % 6;
    const auto commands = random_recording(random, 2 + random() % 40, resources);
    ASSERT_EQ(hazards(commands, resources), 0) << i;
    for (const Command& c : commands) barriers += c.barrier.has_value();
  }
  EXPECT_GT(barriers, 10000u);
}

// The checker itself: most barriers cannot be left out, and one without accesses makes nothing visible.
TEST(HazardsAtRandom, TheCheckerNoticesAMissingBarrier) {
  std::mt19937 random(2);
  int tried = 0, noticed = 0, blind = 0;
  for (int i = 0; i < 300; ++i) {
    auto commands = random_recording(random, 20, 4);
    for (size_t k = 1; k < commands.size(); ++k) {
      if (!commands[k].barrier) continue;
      const Barrier kept = *commands[k].barrier;
      ++tried;
      commands[k].barrier.reset();
      noticed += hazards(commands, 4) > 0;
      commands[k].barrier = Barrier{kept.source_stages, kept.destination_stages, 0, 0};
      blind += kept.source_access != 0 && hazards(commands, 4) > 0;
      commands[k].barrier = kept;
    }
  }
  EXPECT_GT(noticed, tried * 8 / 10) << tried;
  EXPECT_GT(blind, tried / 3) << tried;
}

}  // namespace
}  // namespace iclk::engine
