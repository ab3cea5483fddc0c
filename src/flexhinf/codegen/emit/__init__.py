"""From a program to LLVM text. Nothing here needs llvmlite: text in, text out."""

from flexhinf.codegen.emit.module import ENTRY, Module, emit_module

__all__ = ["ENTRY", "Module", "emit_module"]
