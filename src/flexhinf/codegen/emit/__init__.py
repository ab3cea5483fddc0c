"""From a program to LLVM text. Nothing here needs llvmlite: text in, text out."""
