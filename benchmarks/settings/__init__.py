"""What a setting of the runs changes in classes, slides and cost."""
