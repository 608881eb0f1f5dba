// The functions of OpenCL C that kernels here call, declared for a compiler that is kept from reading the declarations of all: PoCL 3.0
// has a megabyte of them read for each program, which takes longer than to read the program. Those of numbers are declared for every
// type of number, lest one be called with what another becomes.

#define BUILTIN __attribute__((overloadable, const))
size_t BUILTIN get_global_id(uint);
size_t BUILTIN get_global_size(uint);
size_t BUILTIN get_group_id(uint);
size_t BUILTIN get_local_id(uint);
void __attribute__((overloadable, convergent)) barrier(cl_mem_fence_flags);

#define OF_NUMBERS(type) type BUILTIN min(type, type); type BUILTIN max(type, type); type BUILTIN clamp(type, type, type);
OF_NUMBERS(char) OF_NUMBERS(uchar) OF_NUMBERS(short) OF_NUMBERS(ushort) OF_NUMBERS(int) OF_NUMBERS(uint) OF_NUMBERS(long)
OF_NUMBERS(ulong) OF_NUMBERS(float) OF_NUMBERS(int2)
uint BUILTIN abs(int);
uint BUILTIN abs_diff(int, int);
int BUILTIN all(int2);
int BUILTIN any(int2);
