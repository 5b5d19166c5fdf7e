// Linked into every executable of a sanitizer build: libraries stay loaded until the process ends. The Vulkan loader closes the
// driver with the last instance, and a leak in a library that is gone has no name, so that it could be neither read nor
// suppressed.
extern "C" int dlclose(void*) noexcept { return 0; }
