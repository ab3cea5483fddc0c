"""From a program to LLVM text. Nothing here needs llvmlite: text in, text out."""

from flexhinf.codegen.emit.module import emit_module as emit_module
