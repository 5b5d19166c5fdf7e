// Items of work that workgroups take from a counter, because lavapipe deals workgroups out in equal shares before the first one
// runs: there are more of them than items, and those of a thread that is held up find none left. A workgroup is one subgroup,
// so that nobody waits. Needs `work`, words of ICLK_WORK_WORDS each, all 0 in the beginning: counters, one a dispatch.
uint take_item(uint counter) {
  uint item = 0u;
  if (gl_SubgroupInvocationID == 0u) item = atomicAdd(work[counter * ICLK_WORK_WORDS], 1u);
  return subgroupShuffle(item, 0u);
}
