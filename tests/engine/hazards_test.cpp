#include <iclk/engine/compute/hazards.h>

#include <gtest/gtest.h>

namespace iclk::engine {
namespace {

constexpr uint64_t A = 1, B = 2, D = 3;
constexpr VkPipelineStageFlags compute = VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT, transfer = VK_PIPELINE_STAGE_TRANSFER_BIT,
                               host = VK_PIPELINE_STAGE_HOST_BIT;

class Hazards : public ::testing::Test {
 protected:
  void SetUp() override { before(Stage::transfer, {}); }  // the wait with which every recording begins

  std::optional<Barrier> before(Stage stage, std::initializer_list<Use> uses) {
    return tracker.before(stage, std::span(uses.begin(), uses.size()));
  }
  HazardTracker tracker;
};

Use reads(uint64_t resource) { return {resource, false}; }
Use writes(uint64_t resource) { return {resource, true}; }

TEST(HazardsAtFirst, EverythingBeforeIsWaitedForOnce) {
  HazardTracker tracker;
  const Use use = reads(A);
  const auto first = tracker.before(Stage::compute, std::span(&use, 1));
  ASSERT_TRUE(first);
  EXPECT_EQ(first->source_stages, compute | transfer);
  EXPECT_EQ(first->destination_stages, compute | transfer);
  EXPECT_EQ(first->source_access, VkAccessFlags(VK_ACCESS_SHADER_WRITE_BIT | VK_ACCESS_TRANSFER_WRITE_BIT));
  const Use other = writes(B);
  EXPECT_FALSE(tracker.before(Stage::transfer, std::span(&other, 1)));
}

TEST_F(Hazards, ReadAfterWrite) {
  EXPECT_FALSE(before(Stage::compute, {writes(A)}));
  const auto barrier = before(Stage::compute, {reads(A), writes(B)});
  ASSERT_TRUE(barrier);
  EXPECT_EQ(barrier->source_stages, compute);
  EXPECT_EQ(barrier->destination_stages, compute);
  EXPECT_EQ(barrier->source_access, VkAccessFlags(VK_ACCESS_SHADER_WRITE_BIT));
  EXPECT_TRUE(barrier->destination_access & VK_ACCESS_SHADER_READ_BIT);
  EXPECT_FALSE(before(Stage::compute, {reads(A)})) << "seen already";
  EXPECT_TRUE(before(Stage::transfer, {reads(A)})) << "but not by another stage";
}

TEST_F(Hazards, WriteAfterReadIsAnOrderOnly) {
  EXPECT_FALSE(before(Stage::compute, {reads(A)}));
  const auto barrier = before(Stage::transfer, {writes(A)});
  ASSERT_TRUE(barrier);
  EXPECT_EQ(barrier->source_stages, compute);
  EXPECT_EQ(barrier->destination_stages, transfer);
  EXPECT_EQ(barrier->source_access, 0u);
  EXPECT_EQ(barrier->destination_access, 0u);
}

TEST_F(Hazards, WriteAfterWrite) {
  EXPECT_FALSE(before(Stage::transfer, {writes(A)}));
  const auto barrier = before(Stage::compute, {writes(A)});
  ASSERT_TRUE(barrier);
  EXPECT_EQ(barrier->source_stages, transfer);
  EXPECT_TRUE(barrier->destination_access & VK_ACCESS_SHADER_WRITE_BIT);
}

TEST_F(Hazards, ReadsAfterReadsNeedNothing) {
  EXPECT_FALSE(before(Stage::compute, {reads(A), reads(B)}));
  EXPECT_FALSE(before(Stage::transfer, {reads(A)}));
  EXPECT_FALSE(before(Stage::compute, {reads(A)}));
}

TEST_F(Hazards, OneBarrierSettlesEveryBufferOfItsStages) {
  EXPECT_FALSE(before(Stage::compute, {writes(A)}));
  EXPECT_FALSE(before(Stage::compute, {writes(B)})) << "independent commands overlap";
  EXPECT_TRUE(before(Stage::compute, {reads(A), writes(D)}));
  EXPECT_FALSE(before(Stage::compute, {reads(B)})) << "settled by the barrier for A";
  EXPECT_TRUE(before(Stage::compute, {reads(D)}));
}

TEST_F(Hazards, AnOrderOnlyBarrierMakesNothingVisible) {
  EXPECT_FALSE(before(Stage::compute, {writes(A), reads(B)}));
  EXPECT_TRUE(before(Stage::compute, {writes(B)}));  // write after read: order only
  const auto barrier = before(Stage::compute, {reads(A)});
  ASSERT_TRUE(barrier);
  EXPECT_TRUE(barrier->source_access & VK_ACCESS_SHADER_WRITE_BIT);
}

TEST_F(Hazards, ANewReadIsNotCoveredByAnOldBarrier) {
  EXPECT_FALSE(before(Stage::compute, {reads(A)}));
  EXPECT_TRUE(before(Stage::transfer, {writes(A)}));
  EXPECT_TRUE(before(Stage::compute, {reads(A)}));
  const auto again = before(Stage::transfer, {writes(A)});
  ASSERT_TRUE(again);
  EXPECT_EQ(again->source_stages & compute, compute);
}

TEST_F(Hazards, ReadersOfTwoStagesAreBothWaitedFor) {
  EXPECT_FALSE(before(Stage::compute, {reads(A)}));
  EXPECT_FALSE(before(Stage::transfer, {reads(A)}));
  const auto barrier = before(Stage::compute, {writes(A)});
  ASSERT_TRUE(barrier);
  EXPECT_EQ(barrier->source_stages, compute | transfer);
}

TEST_F(Hazards, ReadAndWriteInOneCommandIsAWrite) {
  EXPECT_FALSE(before(Stage::compute, {writes(A), reads(A)}));
  EXPECT_TRUE(before(Stage::compute, {reads(A), writes(A)}));
  EXPECT_TRUE(before(Stage::compute, {reads(A)}));
}

TEST_F(Hazards, TheHostReads) {
  EXPECT_FALSE(before(Stage::compute, {writes(A)}));
  const auto barrier = before(Stage::host, {reads(A)});
  ASSERT_TRUE(barrier);
  EXPECT_EQ(barrier->destination_stages, host);
  EXPECT_EQ(barrier->destination_access, VkAccessFlags(VK_ACCESS_HOST_READ_BIT));
  EXPECT_FALSE(before(Stage::host, {reads(A)}));
}

}  // namespace
}  // namespace iclk::engine
