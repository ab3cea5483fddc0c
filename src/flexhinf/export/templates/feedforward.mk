CC ?= cc
CFLAGS ?= -O2 -std=c99 -Wall -Wextra -ffp-contract=off

test: check
	./check

check: test.c @{name}.c @{name}.h
	$(CC) $(CFLAGS) -o $@ test.c @{name}.c -lm

.PHONY: test
