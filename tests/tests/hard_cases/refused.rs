//! What cannot be drawn is refused with an error.
