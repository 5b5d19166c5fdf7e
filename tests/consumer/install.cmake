# Installs the build tree BUILD into PREFIX from nothing and looks that nothing internal got there.
cmake_minimum_required(VERSION 3.25)
file(REMOVE_RECURSE ${PREFIX})
execute_process(COMMAND ${CMAKE_COMMAND} --install ${BUILD} --prefix ${PREFIX} COMMAND_ERROR_IS_FATAL ANY OUTPUT_QUIET)

file(GLOB_RECURSE installed RELATIVE ${PREFIX} ${PREFIX}/*)
set(in_rooms include/iclk/shaders/refine/refine.h)  # results that an application's shaders read
foreach(file ${installed})
  if(NOT file IN_LIST in_rooms AND file MATCHES "include/iclk/[^/]+/[^/]+/|\\.spv|\\.comp$|\\.glsl$|CMakeLists|\\.cpp$|gtest")
    message(FATAL_ERROR "${file} is not for users and was installed")
  endif()
endforeach()
foreach(wanted ${in_rooms} include/iclk/engine/error.h include/iclk/align/aligner.h include/iclk/refine/device_refiner.h
    include/iclk/depth/depth_sweep.h include/iclk/iclk.h include/iclk/session/session.h include/iclk/rig/rig.h
    include/iclk/track/tracker.h include/iclk/shaders/shared.h)
  if(NOT wanted IN_LIST installed)
    message(FATAL_ERROR "${wanted} was not installed")
  endif()
endforeach()
