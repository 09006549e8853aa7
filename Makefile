# Two commands for everything; both only need Rust and a C compiler, and see to a Vulkan driver themselves.
#
#   make fly    demo terrain, its database, a flight through it, in out/fly
#   make test   all tests
#
# CARGO_TARGET_DIR is honoured.

.PHONY: fly test

fly:
	@scripts/fly

test:
	@scripts/test
