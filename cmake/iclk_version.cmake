# Run by every build: cmake -DGIT=... -DSOURCE=... -DVERSION=... -DIN=... -DOUT=... -P iclk_version.cmake. OUT is touched only
# where the version is another one, so that a commit compiles one small file.
set(REVISION unknown)
if(GIT)
  # No lock: the build must not come in the way of whoever commits meanwhile.
  execute_process(COMMAND ${GIT} --no-optional-locks -C ${SOURCE} describe --always --dirty
    OUTPUT_VARIABLE described RESULT_VARIABLE failed OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET)
  if(failed EQUAL 0)
    set(REVISION ${described})
  endif()
endif()
configure_file(${IN} ${OUT} @ONLY)
