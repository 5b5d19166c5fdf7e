# An overlay port of the libraries, from the tree that it lies in:
#   vcpkg install iclk --overlay-ports=packaging/vcpkg
get_filename_component(SOURCE_PATH "${CMAKE_CURRENT_LIST_DIR}/../../.." ABSOLUTE)

vcpkg_check_linkage(ONLY_STATIC_LIBRARY)
vcpkg_cmake_configure(
  SOURCE_PATH "${SOURCE_PATH}"
  OPTIONS
    -DICLK_BUILD_APPS=OFF
    -DICLK_BUILD_TESTS=OFF
    -DICLK_BUILD_PYTHON=OFF
    -DICLK_INSTALL=ON
    "-DICLK_GLSLANG=${CURRENT_HOST_INSTALLED_DIR}/tools/glslang/glslang"
)
vcpkg_cmake_install()
vcpkg_cmake_config_fixup(PACKAGE_NAME iclk CONFIG_PATH lib/cmake/iclk)
file(REMOVE_RECURSE "${CURRENT_PACKAGES_DIR}/debug/include" "${CURRENT_PACKAGES_DIR}/debug/share")
vcpkg_install_copyright(FILE_LIST "${SOURCE_PATH}/LICENSE")
