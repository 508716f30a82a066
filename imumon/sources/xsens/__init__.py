"""Xsens (Movella) MTi sensors that send MTData2 messages."""
