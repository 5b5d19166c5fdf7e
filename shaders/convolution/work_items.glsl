// Work items that workgroups take from a counter. lavapipe assigns equal numbers of workgroups to threads before the first one
// runs. There are more workgroups than items, so workgroups of a delayed thread find none left. A workgroup is one subgroup, so
// no lane waits. Needs `work`: one counter per dispatch, each ICLK_WORK_WORDS words, initially 0.
uint take_item(uint counter) {
  uint item = 0u;
  if (gl_SubgroupInvocationID == 0u) item = atomicAdd(work[counter * ICLK_WORK_WORDS], 1u);
  return subgroupShuffle(item, 0u);
}
