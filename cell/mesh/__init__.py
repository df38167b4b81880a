"""Mesh files of users: read strictly, checked, and made one closed surface or refused."""
