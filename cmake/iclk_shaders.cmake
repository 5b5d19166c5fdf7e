# iclk_shaders(target file.comp ...): compiles shaders/file.comp to SPIR-V at build time and embeds it in `target` as
# `extern const` words, in the generated header "file.comp.spv.h" with the array `file_comp_spv`.
# Every shader is rebuilt when any GLSL header changes.
find_program(ICLK_GLSLANG glslangValidator REQUIRED)

function(iclk_shaders target)
  set(source_dir ${PROJECT_SOURCE_DIR}/shaders)
  set(output_dir ${CMAKE_CURRENT_BINARY_DIR}/spirv)
  file(MAKE_DIRECTORY ${output_dir})
  file(GLOB headers CONFIGURE_DEPENDS ${source_dir}/*.glsl ${source_dir}/*.h)
  foreach(shader ${ARGN})
    string(REPLACE "." "_" symbol ${shader})
    set(output ${output_dir}/${shader}.spv.h)
    add_custom_command(OUTPUT ${output}
      COMMAND ${ICLK_GLSLANG} -V --target-env vulkan1.1 --quiet -I${source_dir}
              --vn ${symbol}_spv -o ${output} ${source_dir}/${shader}
      DEPENDS ${source_dir}/${shader} ${headers}
      COMMENT "SPIR-V ${shader}" VERBATIM)
    list(APPEND outputs ${output})
  endforeach()
  target_sources(${target} PRIVATE ${outputs})
  target_include_directories(${target} PRIVATE ${output_dir})
endfunction()
