# iclk_shaders(target [SOURCE_DIR dir] file.comp ...): compiles dir/file.comp (default shaders/) to SPIR-V at build time and
# embeds it: the generated header "file.comp.spv.h" holds the words as the array `file_comp_spv`.
# Every shader is rebuilt when any GLSL header changes.
find_program(ICLK_GLSLANG glslangValidator REQUIRED)

function(iclk_shaders target)
  cmake_parse_arguments(arg "" "SOURCE_DIR" "" ${ARGN})
  set(header_dir ${PROJECT_SOURCE_DIR}/shaders)
  if(NOT arg_SOURCE_DIR)
    set(arg_SOURCE_DIR ${header_dir})
  endif()
  set(output_dir ${CMAKE_CURRENT_BINARY_DIR}/spirv)
  file(MAKE_DIRECTORY ${output_dir})
  file(GLOB headers CONFIGURE_DEPENDS ${header_dir}/*.glsl ${header_dir}/*.h ${arg_SOURCE_DIR}/*.glsl)
  foreach(shader ${arg_UNPARSED_ARGUMENTS})
    string(REPLACE "." "_" symbol ${shader})
    set(output ${output_dir}/${shader}.spv.h)
    add_custom_command(OUTPUT ${output}
      COMMAND ${ICLK_GLSLANG} -V --target-env vulkan1.1 --quiet -I${header_dir}
              --vn ${symbol}_spv -o ${output} ${arg_SOURCE_DIR}/${shader}
      DEPENDS ${arg_SOURCE_DIR}/${shader} ${headers}
      COMMENT "SPIR-V ${shader}" VERBATIM)
    list(APPEND outputs ${output})
  endforeach()
  target_sources(${target} PRIVATE ${outputs})
  target_include_directories(${target} PRIVATE ${output_dir})
endfunction()
