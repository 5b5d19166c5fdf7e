// Everything for alignment: #include <iclk/iclk.h>, and link iclk::session.
#pragma once
#include <iclk/engine/error.h>
#include <iclk/session/align.h>
#include <iclk/session/device.h>
#include <iclk/session/session.h>
