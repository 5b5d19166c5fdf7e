// Push constants of the kernels of whole tiles. main() begins with push = constants: what is read where lanes part is read
// anew, and dearly, by lavapipe.
layout(push_constant) uniform Push { WinogradPush constants; };
WinogradPush push;
#define M (N + 2)
