# iclk_library(room SOURCES ... PUBLIC target ... PRIVATE target ...): a static library iclk_<room> with the alias iclk::<room>.
function(iclk_library room)
  cmake_parse_arguments(arg "" "" "SOURCES;PUBLIC;PRIVATE" ${ARGN})
  add_library(iclk_${room} STATIC ${arg_SOURCES})
  add_library(iclk::${room} ALIAS iclk_${room})
  set_target_properties(iclk_${room} PROPERTIES EXPORT_NAME ${room})
  target_compile_features(iclk_${room} PUBLIC cxx_std_20)
  target_include_directories(iclk_${room} PUBLIC
    $<BUILD_INTERFACE:${ICLK_INCLUDE_DIR}> $<INSTALL_INTERFACE:${CMAKE_INSTALL_INCLUDEDIR}>)
  target_link_libraries(iclk_${room} PUBLIC ${arg_PUBLIC} PRIVATE ${arg_PRIVATE})
  iclk_warnings(iclk_${room})
endfunction()

# iclk_unity(target): compiles eight sources of the target together. Templates of CLI11, JSON and OpenCV then cost the compiler
# once what they cost in each source; the preset `strict` builds source by source.
function(iclk_unity target)
  if(ICLK_UNITY)
    set_target_properties(${target} PROPERTIES UNITY_BUILD ON UNITY_BUILD_BATCH_SIZE 8)
  endif()
endfunction()

# Warnings of our own code; never forced on a project that embeds us.
function(iclk_warnings target)
  target_compile_options(${target} PRIVATE -Wall -Wextra)
  # g++ 12 sees copies that overlap or are endless in `"text" + std::string` (GCC bug 105651).
  target_compile_options(${target} PRIVATE
    $<$<CXX_COMPILER_ID:GNU>:-Wno-restrict> $<$<CXX_COMPILER_ID:GNU>:-Wno-stringop-overflow>
    $<$<CXX_COMPILER_ID:GNU>:-Wno-array-bounds>)
  if(ICLK_WERROR)
    target_compile_options(${target} PRIVATE -Werror)
  endif()
endfunction()

# Headers of others that most sources of a room include, compiled once for the room (precompiled headers): half of the time
# of a small source was theirs. A source includes what it uses all the same: the preset `strict` builds
# without them. None of our own headers is among them, for a change of it would build everything anew.
set(ICLK_STD_HEADERS <algorithm> <array> <cmath> <cstdint> <cstring> <filesystem> <functional> <map> <memory> <optional> <span>
  <sstream> <string> <vector>)
