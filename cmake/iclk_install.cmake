# Install rules: the static libraries, their public headers under include/iclk/<room>, the CMake package. (The command
# is installed by apps/.)
# SPIR-V is embedded in the libraries; what lies in folders of a room stays here.
include(CMakePackageConfigHelpers)
set(ICLK_PACKAGE_DIR ${CMAKE_INSTALL_LIBDIR}/cmake/iclk)

set(ICLK_ROOMS engine align depth refine rig session track render locate)
list(TRANSFORM ICLK_ROOMS PREPEND iclk_ OUTPUT_VARIABLE libraries)
install(TARGETS ${libraries} EXPORT iclk
  ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR})
foreach(room ${ICLK_ROOMS})
  file(GLOB headers CONFIGURE_DEPENDS ${PROJECT_SOURCE_DIR}/${room}/*.h)
  list(FILTER headers EXCLUDE REGEX "/(iclk|geotiff)\\.h$")
  install(FILES ${headers} DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/iclk/${room})
endforeach()
if(TARGET iclk_geotiff)
  install(TARGETS iclk_geotiff EXPORT iclk ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR})
  install(FILES render/geotiff.h DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/iclk/render)
endif()
install(FILES session/iclk.h DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/iclk)
install(FILES shaders/shared.h DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/iclk/shaders)
install(FILES shaders/refine/refine.h DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/iclk/shaders/refine)
# A session finds them there.
install(DIRECTORY models/ DESTINATION ${CMAKE_INSTALL_DATADIR}/iclk/models
  FILES_MATCHING PATTERN "*.safetensors" PATTERN "*.md")
install(FILES LICENSE DESTINATION ${CMAKE_INSTALL_DOCDIR})

install(EXPORT iclk NAMESPACE iclk:: FILE iclkTargets.cmake DESTINATION ${ICLK_PACKAGE_DIR})
configure_package_config_file(cmake/iclkConfig.cmake.in ${PROJECT_BINARY_DIR}/iclkConfig.cmake
  INSTALL_DESTINATION ${ICLK_PACKAGE_DIR} NO_SET_AND_CHECK_MACRO)
write_basic_package_version_file(${PROJECT_BINARY_DIR}/iclkConfigVersion.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${PROJECT_BINARY_DIR}/iclkConfig.cmake ${PROJECT_BINARY_DIR}/iclkConfigVersion.cmake
  DESTINATION ${ICLK_PACKAGE_DIR})
