"""Tests of wovenfab."""
