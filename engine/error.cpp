#include <iclk/engine/error.h>
