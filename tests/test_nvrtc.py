"""The kernels compile, unchanged, for GPUs: NVRTC needs neither a GPU nor a driver for that."""

from __future__ import annotations

import ctypes
import importlib.util
from pathlib import Path

import pytest

CORE = Path(__file__).resolve().parent.parent / "core"

# All of core/ behind one entry point: a thread a pixel, as a GPU host would call it.
KERNEL = """
#include "film.h"
#include "wavefront.h"

using namespace parhelion;

extern "C" __global__ void render(const SceneView* scene, const RenderView* view, FilmPixel* film,
                                  unsigned width, unsigned height, unsigned first, unsigned last) {
  const unsigned x = blockIdx.x * blockDim.x + threadIdx.x;
  const unsigned y = blockIdx.y * blockDim.y + threadIdx.y;
  if (x >= width || y >= height) return;
  PathStats stats;
  for (unsigned s = first; s < last; ++s) {
    PH_ISA::add(film[y * width + x], PH_ISA::radiance(*scene, *view, x, y, s, stats));
  }
}
"""


def library() -> ctypes.CDLL:
    """NVRTC from the nvidia-cuda-nvrtc wheel, wherever the wheel puts it."""
    spec = importlib.util.find_spec("nvidia")
    if spec is None or spec.submodule_search_locations is None:
        pytest.skip("the nvidia-cuda-nvrtc wheel is not installed")
    for folder in spec.submodule_search_locations:
        for file in sorted(Path(folder).rglob("libnvrtc.so.*")):
            if "builtins" not in file.name:
                return ctypes.CDLL(str(file))
    pytest.skip("the nvidia-cuda-nvrtc wheel has no library for this platform")


@pytest.mark.parametrize("architecture", ["compute_90", "sm_90"])
def test_core_compiles(architecture: str, long: bool) -> None:
    machine_code = architecture.startswith("sm_")
    if machine_code and not long:
        pytest.skip("machine code takes three minutes more: --long")
    nvrtc = library()
    version = (ctypes.c_int(), ctypes.c_int())
    assert nvrtc.nvrtcVersion(*map(ctypes.byref, version)) == 0
    program = ctypes.c_void_p()
    source = KERNEL.encode()
    assert nvrtc.nvrtcCreateProgram(ctypes.byref(program), source, b"render.cu", 0, None, None) == 0
    # No optimisation, which takes minutes: this is about compiling at all. Later versions can do so
    # without what debuggers want, which takes three quarters of the time.
    late = tuple(number.value for number in version) >= (12, 8)
    options = [
        f"--gpu-architecture={architecture}".encode(),
        b"--std=c++20",
        f"--include-path={CORE}".encode(),
        b"--device-as-default-execution-space",
        b"--fmad=false",  # as on the CPU: no contraction, the same bits everywhere
        b"-DPH_ISA=cuda",
        b"--Ofast-compile=max" if late else b"--device-debug",
    ]
    texts = (ctypes.c_char_p * len(options))(*options)
    result = nvrtc.nvrtcCompileProgram(program, len(options), texts)
    size = ctypes.c_size_t()
    nvrtc.nvrtcGetProgramLogSize(program, ctypes.byref(size))
    log = ctypes.create_string_buffer(size.value)
    nvrtc.nvrtcGetProgramLog(program, log)
    assert result == 0, log.value.decode()
    ask_size, ask = (
        (nvrtc.nvrtcGetCUBINSize, nvrtc.nvrtcGetCUBIN)
        if machine_code
        else (nvrtc.nvrtcGetPTXSize, nvrtc.nvrtcGetPTX)
    )
    assert ask_size(program, ctypes.byref(size)) == 0
    code = ctypes.create_string_buffer(size.value)
    assert ask(program, code) == 0
    if machine_code:
        assert code.raw[:4] == b"\x7fELF"
        assert b"render" in code.raw
    else:
        assert b".entry render(" in code.raw
    nvrtc.nvrtcDestroyProgram(ctypes.byref(program))
