#include "frame.h"

#include <string.h>

/* CRC-32/ISO-HDLC, four bits at a time: 64 bytes of table instead of 1024. */
uint32_t frame_crc(const uint8_t *data, uint8_t length)
{
	static const uint32_t table[16] = {
		0x00000000, 0x1DB71064, 0x3B6E20C8, 0x26D930AC, 0x76DC4190, 0x6B6B51F4,
		0x4DB26158, 0x5005713C, 0xEDB88320, 0xF00F9344, 0xD6D6A3E8, 0xCB61B38C,
		0x9B64C2B0, 0x86D3D2D4, 0xA00AE278, 0xBDBDF21C,
	};
	uint32_t crc = 0xFFFFFFFF;
	while (length--) {
		crc ^= *data++;
		crc = (crc >> 4) ^ table[crc & 15];
		crc = (crc >> 4) ^ table[crc & 15];
	}
	return ~crc;
}

static uint8_t cobs_encode(uint8_t *wire, const uint8_t *raw, uint8_t length)
{
	uint8_t code_at = 0;
	uint8_t used = 1;
	for (uint8_t i = 0; i < length; i++) {
		if (raw[i] == 0) {
			wire[code_at] = (uint8_t)(used - code_at);
			code_at = used++;
		} else {
			wire[used++] = raw[i];
		}
	}
	wire[code_at] = (uint8_t)(used - code_at);
	return used;
}

/* In place; returns the raw length, 0 where the chain does not end with the segment. */
static uint8_t cobs_decode(uint8_t *data, uint8_t length)
{
	uint8_t in = 0;
	uint8_t out = 0;
	while (in < length) {
		uint8_t code = data[in++];
		if (code - 1 > length - in)
			return 0;
		for (uint8_t i = 1; i < code; i++)
			data[out++] = data[in++];
		if (in < length)
			data[out++] = 0;
	}
	return out;
}

uint8_t frame_encode(uint8_t *wire, const uint8_t header[FRAME_HEADER], const void *payload,
		     uint8_t payload_length)
{
	uint8_t raw[FRAME_MAX_RAW];
	uint8_t length = FRAME_HEADER + payload_length;
	memcpy(raw, header, FRAME_HEADER);
	if (payload_length)
		memcpy(raw + FRAME_HEADER, payload, payload_length);
	uint32_t crc = frame_crc(raw, length);
	memcpy(raw + length, &crc, FRAME_CRC_SIZE);
	uint8_t used = cobs_encode(wire, raw, length + FRAME_CRC_SIZE);
	wire[used++] = 0;
	return used;
}

static enum frame_result decode(struct frame_decoder *decoder)
{
	if (decoder->length > FRAME_MAX_ENCODED)
		return FRAME_LENGTH;
	uint8_t length = cobs_decode(decoder->data, decoder->length);
	/* one byte decodes to nothing without being damaged */
	if (length == 0 && !(decoder->length == 1 && decoder->data[0] == 1))
		return FRAME_COBS;
	if (length < FRAME_HEADER + FRAME_CRC_SIZE)
		return FRAME_LENGTH;
	uint32_t crc;
	memcpy(&crc, decoder->data + length - FRAME_CRC_SIZE, FRAME_CRC_SIZE);
	if (crc != frame_crc(decoder->data, length - FRAME_CRC_SIZE))
		return FRAME_CRC;
	decoder->raw_length = length;
	return FRAME_OK;
}

enum frame_result frame_feed(struct frame_decoder *decoder, uint8_t byte)
{
	if (byte != 0) {
		if (decoder->length < FRAME_MAX_ENCODED)
			decoder->data[decoder->length] = byte;
		if (decoder->length <= FRAME_MAX_ENCODED)
			decoder->length++;
		return FRAME_NONE;
	}
	enum frame_result result = decoder->length ? decode(decoder) : FRAME_NONE;
	decoder->length = 0;
	return result;
}
