"""The repository itself: its pages, its gallery, its size."""
