# iclk_shaders(target [SOURCE_DIR dir] [PLAIN] room/file.comp ...): compiles dir/room/file.comp (default shaders/) to SPIR-V
# at build time and embeds it. The generated header "file.comp.spv.h" holds both builds (shaders/texels.glsl) as
# `file_comp_spv`, an engine::ShaderCode; with PLAIN the words of the first alone, as an array, for who does without the
# engine. Every shader is rebuilt when any GLSL header changes.
find_program(ICLK_GLSLANG glslangValidator REQUIRED)

function(iclk_shaders target)
  cmake_parse_arguments(arg "PLAIN" "SOURCE_DIR" "" ${ARGN})
  set(header_dir ${PROJECT_SOURCE_DIR}/shaders)
  if(NOT arg_SOURCE_DIR)
    set(arg_SOURCE_DIR ${header_dir})
  endif()
  set(output_dir ${CMAKE_CURRENT_BINARY_DIR}/spirv)
  file(MAKE_DIRECTORY ${output_dir})
  file(GLOB_RECURSE headers CONFIGURE_DEPENDS ${header_dir}/*.glsl ${header_dir}/*.h ${arg_SOURCE_DIR}/*.glsl)
  foreach(source ${arg_UNPARSED_ARGUMENTS})
    get_filename_component(shader ${source} NAME)
    set(source ${arg_SOURCE_DIR}/${source})
    string(REPLACE "." "_" symbol ${shader})
    set(output ${output_dir}/${shader})
    set(compile ${ICLK_GLSLANG} -V --target-env vulkan1.1 --quiet -I${header_dir})
    if(arg_PLAIN)
      set(commands COMMAND ${compile} --vn ${symbol}_spv -o ${output}.spv.h ${source})
      set(made ${output}.spv.h)
    else()
      file(CONFIGURE OUTPUT ${output}.spv.h @ONLY CONTENT [[
#pragma once
#include <iclk/engine/compute/kernel.h>

#include "@shader@.texels.h"
#include "@shader@.storage.h"

constexpr iclk::engine::ShaderCode @symbol@_spv(@symbol@_texels, @symbol@_storage);
]])
      set(commands
        COMMAND ${compile} --vn ${symbol}_texels -o ${output}.texels.h ${source}
        COMMAND ${compile} -DICLK_STORAGE_READS --vn ${symbol}_storage -o ${output}.storage.h ${source})
      set(made ${output}.texels.h ${output}.storage.h)
    endif()
    add_custom_command(OUTPUT ${made} ${commands}
      DEPENDS ${source} ${headers} COMMENT "SPIR-V ${shader}" VERBATIM)
    list(APPEND outputs ${made})
  endforeach()
  target_sources(${target} PRIVATE ${outputs})
  target_include_directories(${target} PRIVATE ${output_dir})
endfunction()
