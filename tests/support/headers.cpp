// See CMakeLists.txt: precompiled headers belong to a program.
int main() {}
