# The CPU half of an installed torch wheel. The wheel's own configuration asks for a CUDA toolkit
# when the wheel was built with one, even where only the CPU is used.
if(NOT TORCH_WHEEL)
  message(FATAL_ERROR "TORCH_WHEEL must be the folder of the installed torch package")
endif()
set(TORCH_INCLUDE_DIRS "${TORCH_WHEEL}/include" "${TORCH_WHEEL}/include/torch/csrc/api/include")
include_directories(SYSTEM ${TORCH_INCLUDE_DIRS})
set(TORCH_LIBRARIES "${TORCH_WHEEL}/lib/libtorch.so" "${TORCH_WHEEL}/lib/libtorch_cpu.so" "${TORCH_WHEEL}/lib/libc10.so")
link_directories("${TORCH_WHEEL}/lib")
set(CMAKE_BUILD_RPATH "${TORCH_WHEEL}/lib")
set(TORCH_FOUND TRUE)
