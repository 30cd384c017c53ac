"""The torture study: what trials start from (`base`), how they run (`trials`), how the cache is damaged (`damages`)."""
