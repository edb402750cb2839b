"""Stages as they are called, kept in files, and computed side by side in processes of their own."""
