// The functions of OpenCL C that kernels here call, declared for a compiler that is kept from reading the declarations of all: PoCL 3.0
// has a megabyte of them read for each program, which takes longer than to read the program.

#define BUILTIN __attribute__((overloadable, const))
size_t BUILTIN get_global_id(uint);
size_t BUILTIN get_global_size(uint);
size_t BUILTIN get_group_id(uint);
size_t BUILTIN get_local_id(uint);
int BUILTIN min(int, int);
int BUILTIN max(int, int);
ulong BUILTIN min(ulong, ulong);
uint BUILTIN min(uint, uint);
uint BUILTIN abs_diff(int, int);
void __attribute__((overloadable, convergent)) barrier(cl_mem_fence_flags);
